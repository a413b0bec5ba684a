//! Rival effects: every other effect in a finding's place, and the observation that would decide between them.

use super::crossfit::CrossFit;
use super::diagnosis::Rival;
use super::evidence::Evidence;
use super::fit_state::{AS_GOOD, FitState, SelectedEffect, cosine};
use super::frame_nuisance::project_own;
use super::linear_system::{Whitened, dot};
use super::star_images::REACH_PX;
use super::stepwise::{agreement, is_observable};
use crate::calibrate::{BundleSolution, Column};
use crate::effects::Observation;
use crate::statistics::order::ascending;
use crate::statistics::significance::normal_cdf;

/// Effects of a smaller cosine do not leave the same trace, however much each of them explains: neither members of a set nor listed.
const ALIKE_FROM: f64 = 0.5;
/// So many are tried on held-out frames.
const HELD_OUT: usize = 3;

/// A rival, whether it is a member of the set, and its columns.
pub(super) struct Listed {
    pub(super) rival: Rival,
    pub(super) in_set: bool,
    entry: SelectedEffect,
}

/// A finding's rivals, the members of its set first.
pub(super) fn rivals(evidence: &Evidence, stand: &FitState, entries: &[SelectedEffect], k: usize) -> Vec<Listed> {
    let white = |entry: SelectedEffect| stand.white(evidence, &[entry]);
    let without = stand.without(evidence, entries, k);
    let ln_n = stand.ln_n();
    let criterion = |entry: SelectedEffect, own: &[Whitened]| {
        let (t, rank) = without.score(own);
        let searched = if evidence.hypotheses[entry.hypothesis].variants.len() > 1 { 1.0 } else { 0.0 };
        (t, t - (rank as f64 + searched) * ln_n + agreement(evidence, &without, entry))
    };
    let mine = white(entries[k]);
    let (t_mine, best) = criterion(entries[k], &mine);
    let snr = t_mine.max(0.0).sqrt();
    let mut found: Vec<Listed> = Vec::new();
    for (index, hypothesis) in evidence.hypotheses.iter().enumerate() {
        if entries.iter().any(|entry| entry.hypothesis == index) {
            continue;
        }
        let at_best = (0..hypothesis.variants.len())
            .map(|variant| {
                let entry = SelectedEffect { hypothesis: index, variant };
                let own = white(entry);
                let (_, value) = criterion(entry, &own);
                (value, own, entry)
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((value, own, entry)) = at_best else { continue };
        if !is_observable(evidence, &without, entry) {
            continue;
        }
        let cos = cosine(&without.fit, &mine, &own);
        let delta_bic = best - value;
        if cos >= ALIKE_FROM {
            let in_set = delta_bic < AS_GOOD;
            let p_correct = normal_cdf(snr * ((1.0 - cos) / 2.0).max(0.0).sqrt());
            let rival = Rival { id: hypothesis.id().to_owned(), cos, delta_bic, p_correct, held_out_delta_chi2: None };
            found.push(Listed { rival, in_set, entry });
        }
    }
    ascending(&mut found, |a| a.rival.delta_bic);
    found
}

/// Falls of χ² on held-out images with each of the nearest rivals in the place of a hypothesis, in the turns that chose this one.
pub(super) fn held_out_of_rivals(evidence: &Evidence, tried: &CrossFit, hypothesis: usize, listed: &mut [Listed]) {
    for own in listed.iter_mut().take(HELD_OUT) {
        own.rival.held_out_delta_chi2 = Some(tried.in_place(evidence, hypothesis, own.entry));
    }
}

/// One kind of further observation.
struct Further {
    text: &'static str,
    change: fn(usize, &Observation) -> Observation,
    /// How much more each image counts, by its place on the frame (ξ, η in half widths) and magnitude above the mean.
    weight: fn([f64; 2], f64) -> f64,
}

/// A number in −1…1 that looks random, from a frame's number and which number it is.
fn scattered(frame: usize, which: usize) -> f64 {
    let x = (frame as f64 + 1.0) * 0.754_877_666 + which as f64 * 0.569_840_291;
    2.0 * (x - x.floor()) - 1.0
}

/// Two effects of which a smaller share tells them apart cannot be told apart by more of the same.
const HARDLY: f64 = 0.05;

const MENU: &[Further] = &[
    Further { text: "more frames like these", change: |_, observation| *observation, weight: |_, _| 1.0 },
    Further {
        text: "frames at other temperatures, not in step with time or pointing",
        change: |frame, o| Observation { temperature_offset_k: o.temperature_offset_k.map(|_| 10.0 * scattered(frame, 0)), ..*o },
        weight: |_, _| 1.0,
    },
    Further {
        text: "frames at other times, far from these",
        change: |frame, o| Observation {
            time_offset_h: o.time_offset_h.map(|t| t + 20.0 * scattered(frame, 1)),
            order_offset: o.order_offset.map(|t| t + 100.0 * scattered(frame, 1)),
            ..*o
        },
        weight: |_, _| 1.0,
    },
    Further {
        text: "frames while the camera turns at other rates, in both senses",
        change: |frame, o| Observation { rate_rad_s: o.rate_rad_s.map(|_| [2, 3, 4].map(|which| 0.01 * scattered(frame, which))), ..*o },
        weight: |_, _| 1.0,
    },
    Further {
        text: "frames pointed elsewhere with respect to the velocity",
        change: |frame, o| Observation {
            velocity_km_s: o.velocity_km_s.map(|_| [5, 6, 7].map(|which| 30.0 * scattered(frame, which))),
            ..*o
        },
        weight: |_, _| 1.0,
    },
    Further {
        text: "frames at other altitudes and with the horizon at other angles",
        change: |frame, o| Observation {
            zenith: o.zenith.map(|zenith| {
                let tilted: [f64; 3] = std::array::from_fn(|axis| zenith[axis] + 0.5 * scattered(frame, 8 + axis));
                let length = tilted.iter().map(|component| component * component).sum::<f64>().sqrt();
                tilted.map(|component| component / length)
            }),
            ..*o
        },
        weight: |_, _| 1.0,
    },
    Further {
        text: "more stars in the corners of the frame",
        change: |_, o| *o,
        weight: |[x, y], _| if x.hypot(y) > 0.9 { 9.0 } else { 0.0 },
    },
    Further { text: "more bright stars", change: |_, o| *o, weight: |_, fainter| if fainter < -0.5 { 9.0 } else { 0.0 } },
    Further { text: "longer exposures, for faint stars", change: |_, o| *o, weight: |_, fainter| if fainter > 0.5 { 9.0 } else { 0.0 } },
];

/// The observation of the menu that best tells two effects apart, in words; `None` if none helps.
pub(super) fn decided_by(
    evidence: &Evidence,
    stand: &FitState,
    joint: &BundleSolution,
    [a, b]: [SelectedEffect; 2],
    faintness: &[f64],
) -> Option<String> {
    let camera = joint.model().camera();
    let (half, middle) = (camera.width_px as f64 / 2.0, [(camera.width_px as f64 - 1.0) / 2.0, (camera.height_px as f64 - 1.0) / 2.0]);
    let positions: Vec<[f64; 2]> = evidence.predicted_px(REACH_PX).collect();
    let columns_of = |joint: &BundleSolution, entry: SelectedEffect| -> Option<Vec<Column>> {
        let hypothesis = &evidence.hypotheses[entry.hypothesis];
        joint.columns_of(hypothesis.id(), &hypothesis.variants[entry.variant].start, &hypothesis.fitted)
    };
    let whitened = |entry: SelectedEffect| stand.white(evidence, &[entry]);
    let apart = |option: &Further| -> Option<f64> {
        let changed = joint.with_frames(option.change);
        let roots: Vec<f64> = positions
            .iter()
            .zip(faintness)
            .map(|([x, y], fainter)| (option.weight)([(x - middle[0]) / half, (y - middle[1]) / half], *fainter).sqrt())
            .collect();
        let rest = |entry: SelectedEffect| -> Option<Vec<Whitened>> {
            let (here, there) = (columns_of(joint, entry)?, columns_of(&changed, entry)?);
            let more = here.iter().zip(&there).map(|(here, there)| {
                let mut first = stand.fit.project(&evidence.white(&stand.noise, here));
                let scaled: Column = there.iter().zip(&roots).map(|([x, y], root)| [x * root, y * root]).collect();
                // New frames have attitudes of their own; the camera is known well by then.
                first.extend(project_own(&stand.system, &stand.take, &evidence.white(&stand.noise, &scaled)));
                first
            });
            Some(more.collect())
        };
        let (a, b) = (rest(a)?, rest(b)?);
        let (a, b) = (a.first()?, b.first()?);
        // What is left of a beside b: the information that decides.
        let (aa, bb, ab) = (dot(a, a), dot(b, b), dot(a, b));
        Some(if bb > 0.0 && aa > 0.0 { 1.0 - ab * ab / (aa * bb) } else { 0.0 })
    };
    // More of the same tells no more than what is there, relative to its size.
    let same = cosine(&stand.fit, &whitened(a), &whitened(b));
    let now = 1.0 - same * same;
    let best = MENU[1..].iter().filter_map(|option| Some((apart(option)?, option.text))).max_by(|x, y| x.0.total_cmp(&y.0))?;
    Some(if best.0 > (now * 1.2).max(HARDLY) {
        best.1.to_owned()
    } else if now > HARDLY {
        MENU[0].text.to_owned()
    } else {
        "nothing that was tried (other temperatures, times, rates, pointings, places on the frame, brightness) would tell them apart"
            .to_owned()
    })
}
