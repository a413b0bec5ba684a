//! World-coordinate headers of all frames.

use super::sip::Sip;
use super::tpv::Tpv;
use super::view::View;
use super::wcs::{Meaning, Polynomials, Wcs};
use super::{ExchangeError, Exported, File, Format, Places, Residual, Subject, SubjectFrame};
use crate::effects::ids;

/// A frame's coordinates, before what is said of all of them is known.
struct Ready {
    frame: usize,
    wcs: Wcs,
    inverse: Option<Polynomials>,
    /// What the places are, in a sentence.
    comment: String,
}

/// How near the coordinates come, the worst of all frames.
#[derive(Clone, Copy)]
struct Worst {
    order: i32,
    coefficients: usize,
    residual: Residual,
    inverse_max_px: f64,
}

/// The headers of all frames.
pub(super) fn headers(subject: &Subject, exported: &mut Exported) -> Result<(), ExchangeError> {
    if subject.frames.is_empty() {
        let reason = "world coordinates need an attitude, and no frame of the calibration has one".to_owned();
        return Err(ExchangeError::NoRoom { format: "a FITS header", reason });
    }
    let (ready, worst) = match subject.places {
        Places::Apparent => of_light(subject, exported.to)?,
        Places::Catalog => of_places(subject, exported.to)?,
    };
    exported.coefficients = worst.coefficients;
    exported.notes.extend(notes(subject));
    match exported.to {
        Format::Sip => {
            exported.model = format!("TAN-SIP, A and B of order {}", worst.order);
            exported.inverse_max_px = Some(worst.inverse_max_px);
            exported.notes.push(format!("AP and BP, from the sky to the pixel, are off by {:.1e} px at most", worst.inverse_max_px));
        }
        _ => exported.model = format!("TPV of order {}", worst.order),
    }
    exported.judged(worst.residual);
    let meaning = match subject.places {
        Places::Catalog => Meaning::Catalog,
        Places::Apparent => Meaning::Apparent,
    };
    let comments = exported.comments();
    let file = |one: Ready| {
        let comments: Vec<String> = comments.iter().cloned().chain([one.comment]).collect();
        File { name: format!("frame-{:04}.wcs", one.frame), bytes: one.wcs.header(one.inverse.as_ref(), meaning, &comments) }
    };
    exported.files = ready.into_iter().map(file).collect();
    Ok(())
}

/// Directions of the light: one distortion for all frames.
fn of_light(subject: &Subject, to: Format) -> Result<(Vec<Ready>, Worst), ExchangeError> {
    let view = View::of_camera(&subject.model);
    let ready = |frame: &SubjectFrame, wcs: Wcs, inverse: Option<Polynomials>| {
        let comment = "directions are those of the light as it arrives".to_owned();
        Ready { frame: frame.frame, wcs, inverse, comment }
    };
    let frames = subject.frames.iter();
    if to == Format::Sip {
        let sip = Sip::of(&view, subject.parity)?;
        let all = frames.map(|frame| {
            let (wcs, inverse) = sip.ready(&frame.attitude);
            ready(frame, wcs, Some(inverse))
        });
        return Ok((all.collect(), Worst::of_sip(&sip)));
    }
    let tpv = Tpv::of(&view, subject.parity)?;
    let all = frames.map(|frame| Ok(ready(frame, tpv.ready(&frame.attitude)?, None))).collect::<Result<_, ExchangeError>>()?;
    Ok((all, Worst::of_tpv(&tpv)))
}

/// Places of the catalogue: every frame has a map of its own, since aberration and refraction are in it.
fn of_places(subject: &Subject, to: Format) -> Result<(Vec<Ready>, Worst), ExchangeError> {
    let mut all = Vec::with_capacity(subject.frames.len());
    let mut worst: Option<Worst> = None;
    for frame in &subject.frames {
        let unknown = || {
            let reason = "it does not say when and where its frames were taken, which places of the catalogue need; calibrate once more with this version, or take the directions of the light with --wcs apparent";
            ExchangeError::NoRoom { format: "a FITS header", reason: reason.to_owned() }
        };
        let view = View::of_places(&subject.model, frame).ok_or_else(unknown)?;
        let attitude = view.attitude().unwrap_or(frame.attitude);
        let (wcs, inverse, own) = if to == Format::Sip {
            let sip = Sip::of(&view, subject.parity)?;
            let (wcs, inverse) = sip.ready(&attitude);
            (wcs, Some(inverse), Worst::of_sip(&sip))
        } else {
            let tpv = Tpv::of(&view, subject.parity)?;
            (tpv.ready(&attitude)?, None, Worst::of_tpv(&tpv))
        };
        all.push(Ready { frame: frame.frame, wcs, inverse, comment: epoch_words(frame) });
        worst = Some(worst.map_or(own, |known| known.or(own)));
    }
    let worst = worst.ok_or(ExchangeError::NoFit { what: "the polynomial of the distortion" })?;
    Ok((all, worst))
}

impl Worst {
    fn of_sip(sip: &Sip) -> Self {
        Self { order: sip.order, coefficients: sip.coefficients(), residual: sip.residual, inverse_max_px: sip.inverse_max_px }
    }

    fn of_tpv(tpv: &Tpv) -> Self {
        Self { order: tpv.order, coefficients: tpv.coefficients, residual: tpv.residual, inverse_max_px: 0.0 }
    }

    fn or(self, other: Self) -> Self {
        let beyond = self.residual.beyond_max_px.zip(other.residual.beyond_max_px).map(|(a, b)| a.max(b));
        Self {
            order: self.order.max(other.order),
            coefficients: self.coefficients.max(other.coefficients),
            residual: Residual {
                rms_px: self.residual.rms_px.max(other.residual.rms_px),
                max_px: self.residual.max_px.max(other.residual.max_px),
                beyond_max_px: beyond,
            },
            inverse_max_px: self.inverse_max_px.max(other.inverse_max_px),
        }
    }
}

/// The date of a frame's places.
fn epoch_words(frame: &SubjectFrame) -> String {
    let moved = frame.sky.as_ref().filter(|sky| sky.ids().contains(&ids::PROPER_MOTION));
    match moved.and_then(|sky| sky.observation().epoch_yr) {
        Some(epoch_yr) => {
            format!("places are those of the Julian year {epoch_yr:.6} (TDB): give stars with their proper motion up to then")
        }
        None => "places are those of the catalogue's own epoch: give stars without their proper motion".to_owned(),
    }
}

/// What to mind of all frames.
fn notes(subject: &Subject) -> Vec<String> {
    let physics = if subject.physics.is_empty() { "none".to_owned() } else { subject.physics.join(", ") };
    let has = |id: &str| subject.physics.iter().any(|known| known == id);
    let mut notes = Vec::new();
    match subject.places {
        Places::Catalog => {
            notes.push("world coordinates are places of the catalogue: ICRS, from the barycentre of the solar system".to_owned());
            notes.push(format!("what is done to the light on its way is part of the map: {physics}"));
        }
        Places::Apparent => {
            let aberration =
                if has(ids::STELLAR_ABERRATION) { "is in" } else { "was not modelled, so its mean over the frame is taken up by" };
            let refraction = if has(ids::REFRACTION) { "is in" } else { "was not modelled, so its mean over the frame is taken up by" };
            notes.push(format!("directions are those of the light as it arrives, in ICRS axes; star directions contain: {physics}"));
            notes.push(format!("aberration {aberration} these directions, refraction {refraction} them"));
        }
    }
    notes.push("rows count downwards from the first one stored; FITS readers show it at the bottom".to_owned());
    notes
}
