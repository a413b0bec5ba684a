//! The light that falls on the pixels of a frame on average: stars and sky, with what is hidden in optics and sky.
//!
//! Sources: the cosine law and the clipped pupil: Asada, Amano & Baba, ICPR 1996, 1, 186 (two circles of the pupil and the rim, whose common area is
//! the aperture off axis); extinction and colour term: Henden & Kaitchuck, *Astronomical Photometry* (1982), 4.4.

use super::camera::{Conditions, ImageWorld, SIZE_PX, SkyStar};
use super::hidden::{Causes, HiddenImage};
use super::kind::PixelKind;
use super::spread::{Blur, coma, trail};

/// Radius over which glare falls off, px.
const GLARE_PX: f64 = 25.0;
/// Penumbra of a field stop, px.
const PENUMBRA_PX: f64 = 4.0;

/// Column and row as half-diagonals from the middle.
pub(super) fn in_field(at: [f64; 2]) -> [f64; 2] {
    let half = SIZE_PX as f64 / 2.0;
    at.map(|value| (value + 0.5 - half) / (half * 2.0_f64.sqrt()))
}

/// Expected electrons of a frame, before the detector does anything.
pub(super) fn light(world: &ImageWorld, number: usize, causes: Causes<'_>) -> Vec<f64> {
    let frame = &world.frames[number];
    let dimmed = dimmed(number, causes);
    let half = SIZE_PX as f64 / 2.0;
    let stray = causes.find(PixelKind::StrayLight);
    let mut light: Vec<f64> = (0..SIZE_PX * SIZE_PX)
        .map(|k| {
            let [u, v] = [(k % SIZE_PX) as f64 / half - 1.0, (k / SIZE_PX) as f64 / half - 1.0];
            let sky = frame.sky_e[0] + frame.sky_e[1] * u + frame.sky_e[2] * v;
            let stray = stray.map_or(0.0, |own| own.size * (1.0 + own.number(0) * u + own.number(1) * v));
            sky * dimmed + stray
        })
        .collect();
    for star in &frame.stars {
        let [electrons, colour_blur] = [star_electrons(star, causes) * dimmed, colour_focus(star, causes)];
        let blur = blur(world, frame, star, number, causes, colour_blur);
        world.camera.profile.shine(&mut light, [SIZE_PX; 2], [star.x_px, star.y_px], electrons, &blur);
    }
    glare(&mut light, frame, causes);
    shade(&mut light, causes);
    light
}

/// Light of a frame over what it should have.
fn dimmed(number: usize, causes: Causes<'_>) -> f64 {
    let of = |kind| causes.find(kind).filter(|own| own.number(0) as usize == number).map_or(0.0, |own| own.size);
    10.0_f64.powf(-0.4 * of(PixelKind::FrameDimmer)) * (1.0 + of(PixelKind::ExposureTime))
}

/// Electrons of a star behind air and filter.
fn star_electrons(star: &SkyStar, causes: Causes<'_>) -> f64 {
    let magnitudes = causes.size(PixelKind::Extinction) * star.airmass + causes.size(PixelKind::Passband) * star.colour;
    star.electrons * 10.0_f64.powf(-0.4 * magnitudes)
}

fn colour_focus(star: &SkyStar, causes: Causes<'_>) -> f64 {
    causes.size(PixelKind::AxialColour) * star.colour
}

/// How a star's image is blurred: the geometric blur of defocus, coma, motion.
fn blur(world: &ImageWorld, frame: &Conditions, star: &SkyStar, number: usize, causes: Causes<'_>, colour_px: f64) -> Blur {
    let [u, v] = in_field([star.x_px, star.y_px]);
    let tilt = causes.find(PixelKind::FieldTilt).map_or(0.0, |own| own.size * (own.number(0) * u + own.number(1) * v));
    // Radius of the disc, signed: all displacements of the focus add.
    let radius_px = world.camera.blur_px
        + tilt
        + causes.size(PixelKind::FieldCurvature) * (u * u + v * v)
        + colour_px
        + causes.size(PixelKind::FocusWithTemperature) * frame.kelvin
        + causes.size(PixelKind::FocusWithTime) * frame.hours;
    let mut variance = 0.25 * radius_px * radius_px;
    if let Some(own) = causes.find(PixelKind::Jitter) {
        variance += (own.size * own.number(number)).powi(2);
    }
    let mut places = Vec::new();
    let hidden = causes.size(PixelKind::Coma);
    let tail = [hidden * u + world.camera.tail_px[0], hidden * v + world.camera.tail_px[1]];
    if tail != [0.0; 2] {
        places = coma(tail[0].hypot(tail[1]), tail[1].atan2(tail[0]));
    }
    if let Some(own) = causes.find(PixelKind::MotionSmear) {
        // Turning about y moves stars along x, about x along y.
        let length = own.size * world.world.optics.focal_px * frame.exposure_s;
        places = trail([-length * frame.rate_rad_s[1], length * frame.rate_rad_s[0]]);
    }
    Blur { added_px2: [variance, 0.0, variance], places, edge_drop: causes.size(PixelKind::IntrapixelResponse) }
}

/// Light scattered far from the brightest stars: a share of it in a halo that falls as 1/(r² + r₀²), cut at the frame (King, PASP 83, 199 (1971),
/// for the outer profile of star images).
fn glare(light: &mut [f64], frame: &Conditions, causes: Causes<'_>) {
    const BRIGHTEST: usize = 12;
    let share = causes.size(PixelKind::VeilingGlare);
    if share == 0.0 {
        return;
    }
    let mut stars: Vec<&SkyStar> = frame.stars.iter().collect();
    stars.sort_by(|a, b| b.electrons.total_cmp(&a.electrons));
    let reach = SIZE_PX as f64 / GLARE_PX;
    let norm = (std::f64::consts::PI * GLARE_PX * GLARE_PX * (1.0 + reach * reach).ln()).recip();
    for star in stars.into_iter().take(BRIGHTEST) {
        for (k, value) in light.iter_mut().enumerate() {
            let [dx, dy] = [(k % SIZE_PX) as f64 - star.x_px, (k / SIZE_PX) as f64 - star.y_px];
            *value += share * star.electrons * norm / (1.0 + (dx * dx + dy * dy) / (GLARE_PX * GLARE_PX));
        }
    }
}

/// What optics hold back: cosine law, clipped pupil, field stop.
fn shade(light: &mut [f64], causes: Causes<'_>) {
    let vignetting = causes.find(PixelKind::Vignetting).map(Lens::new);
    let stop = causes.find(PixelKind::FieldStop).map(|own| (1.0 - own.size) * SIZE_PX as f64 / 2.0_f64.sqrt());
    if vignetting.is_none() && stop.is_none() {
        return;
    }
    let middle = (SIZE_PX as f64 - 1.0) / 2.0;
    for (k, value) in light.iter_mut().enumerate() {
        let radius_px = ((k % SIZE_PX) as f64 - middle).hypot((k / SIZE_PX) as f64 - middle);
        if let Some(lens) = &vignetting {
            *value *= lens.through(radius_px * 2.0_f64.sqrt() / SIZE_PX as f64);
        }
        if let Some(stop_px) = stop {
            *value *= ((stop_px - radius_px) / PENUMBRA_PX + 0.5).clamp(0.0, 1.0);
        }
    }
}

/// A lens whose image darkens towards the corner.
struct Lens {
    /// Tangent of the chief ray's angle at the corner.
    tangent: f64,
    /// Radius of the rim over that of the pupil, and distance of their middles at the corner.
    rim: f64,
    apart: f64,
}

impl Lens {
    /// The loss at the corner is parted between the cosine law and the rim.
    fn new(own: &HiddenImage) -> Self {
        let loss = own.size.clamp(0.0, 0.95);
        let by_rim = 1.0 - (1.0 - loss).powf(own.number(0));
        let by_angle = 1.0 - (1.0 - loss).powf(1.0 - own.number(0));
        // cos⁴ = 1/(1 + t²)².
        let tangent = ((1.0 - by_angle).powf(-0.5) - 1.0).sqrt();
        let rim = own.number(1).max(1.0);
        let (mut low, mut high) = (0.0_f64, 1.0 + rim);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if common_area(rim, middle) > 1.0 - by_rim { low = middle } else { high = middle }
        }
        Self { tangent, rim, apart: 0.5 * (low + high) }
    }

    /// Share of the light that passes, at a radius in half-diagonals.
    fn through(&self, radius: f64) -> f64 {
        let tangent = self.tangent * radius;
        common_area(self.rim, self.apart * radius) / (1.0 + tangent * tangent).powi(2)
    }
}

/// Area that circles of radii 1 and `rim` ≥ 1 have in common, over that of the unit circle.
fn common_area(rim: f64, apart: f64) -> f64 {
    if apart <= rim - 1.0 {
        return 1.0;
    }
    if apart >= rim + 1.0 {
        return 0.0;
    }
    let square = apart * apart;
    let unit = ((square + 1.0 - rim * rim) / (2.0 * apart)).clamp(-1.0, 1.0).acos();
    let other = ((square + rim * rim - 1.0) / (2.0 * apart * rim)).clamp(-1.0, 1.0).acos();
    let kite = ((1.0 + rim - apart) * (apart + 1.0 - rim) * (apart - 1.0 + rim) * (apart + 1.0 + rim)).max(0.0).sqrt();
    (unit + rim * rim * other - 0.5 * kite) / std::f64::consts::PI
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the area counted on a grid, and the loss in the corner as asked.
    #[test]
    fn the_pupil_is_clipped_by_the_rim() {
        for (rim, apart) in [(1.0, 0.4), (1.1, 0.7), (1.2, 1.5), (1.05, 2.2)] {
            const GRID: usize = 800;
            let inside = (0..GRID * GRID).filter(|k| {
                let [x, y] = [k % GRID, k / GRID].map(|at| 2.0 * (at as f64 + 0.5) / GRID as f64 - 1.0);
                x.hypot(y) < 1.0 && (x - apart).hypot(y) < rim
            });
            let counted = inside.count() as f64 * 4.0 / (GRID * GRID) as f64 / std::f64::consts::PI;
            assert!((common_area(rim, apart) - counted).abs() < 3e-3, "{rim} {apart}: {} {counted}", common_area(rim, apart));
        }
        for loss in [0.02, 0.3, 0.7] {
            let lens = Lens::new(&HiddenImage { kind: PixelKind::Vignetting, size: loss, numbers: vec![0.6, 1.1] });
            assert!((lens.through(1.0) - (1.0 - loss)).abs() < 1e-6 && (lens.through(0.0) - 1.0).abs() < 1e-12);
        }
    }
}
