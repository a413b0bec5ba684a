//! Profile of an effect for a picture: the displacements of the star images that belong to it, with attitudes, camera and all other effects
//! removed, and the model curve.
//!
//! Most of what an effect displaces attitudes and camera may take up; that share shows in no residual, and adding it back would draw the
//! model to itself. Drawn is therefore what is left of both: with M what the fit leaves of the effect's column, θ its size and ψ/d the
//! pseudo-values of the residuals (outliers drawn in, Huber 1981, 7.8), the data are Mθ + ψ/d and the model is Mθ. In a bin b of star images
//!
//! ```text
//! amplitude a_b = 1 + Σ Mθ·ψ/d / Σ|Mθ|²,   σ(a_b) = √c/(d·√Σ|Mθ|²);   drawn: a_b·m_b ± σ(a_b)·|m_b|,   m_b = ± rms of Mθ in px
//! ```
//! A line through zero fitted to what is drawn has a slope with the error of θ over θ, as the finding says it: nothing is lost to the bins.

use super::diagnosis::{Finding, FoundParameter, Profile};
use super::evidence::Evidence;
use super::final_fit::FinalFit;
use super::findings::Context;
use super::fit_state::SelectedEffect;
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::profile_bin::ProfileBin;
use super::star_images::REACH_PX;
use crate::statistics::order::ascending;

/// Bins.
const BINS: usize = 12;
/// A covariate and a component are drawn if the bins' means hold so much of what tells the effect's size; else it is drawn against what it
/// predicts.
const TELLS: f64 = 0.6;
/// A covariate that is known of fewer star images (by what they tell) shows another size than was found.
const KNOWN: f64 = 0.97;
/// The abscissa where no covariate tells: how far the effect displaces each star image.
pub const PREDICTED: &str = "predicted-displacement";

/// A direction on the frame at every star image, and its name.
type Component<'a> = (&'static str, &'a dyn Fn(usize) -> [f64; 2]);

/// What is drawn of each star image.
struct Drawn<'a> {
    evidence: &'a Evidence,
    /// The images that take part.
    taken: Vec<usize>,
    /// The model, px.
    model_px: Vec<[f64; 2]>,
    /// Σ of squares and of products with the pseudo-values, whitened.
    square: Vec<f64>,
    product: Vec<f64>,
    /// 1/σ² of each, px⁻².
    weight: Vec<f64>,
    /// Standard error of a whitened number.
    scatter: f64,
}

impl<'a> Drawn<'a> {
    /// Of column `j` of entry `k`, whose size is `value`.
    fn new(solved: &'a FinalFit, k: usize, j: usize, value: f64) -> Self {
        let (evidence, stand) = (&solved.evidence, &solved.stand);
        let white = |entry: &SelectedEffect| stand.white(evidence, std::slice::from_ref(entry));
        let mut beside: Vec<Whitened> = Vec::new();
        let mut own = None;
        for (index, entry) in solved.entries.iter().enumerate() {
            let of_entry: Vec<Whitened> = white(entry);
            for (place, column) in of_entry.into_iter().enumerate() {
                if index == k && place == j {
                    own = Some(column);
                } else {
                    beside.push(column);
                }
            }
        }
        let fit = Fit::new(&stand.system, &stand.take, &beside.iter().collect::<Vec<_>>());
        // The residual falls by the effect: what it displaces is minus its column times its size.
        let model: Whitened = own.map_or_else(Vec::new, |own| fit.project(&own)).into_iter().map(|rest| -value * rest).collect();
        let (psi, d) = (&stand.fit.psi, stand.fit.d);
        let images = 0..model.len() / 2;
        let sum = |k: usize, of: &dyn Fn(usize) -> f64| of(2 * k) + of(2 * k + 1);
        let weight = |k: usize| {
            let sigma = stand.noise.sigma_px(&evidence.images[k], evidence.place[k]);
            1.0 / (sigma * sigma)
        };
        Self {
            evidence,
            taken: images.clone().filter(|k| stand.take[*k]).collect(),
            square: images.clone().map(|k| sum(k, &|n| model[n] * model[n])).collect(),
            product: images.clone().map(|k| sum(k, &|n| model[n] * psi[n] / d)).collect(),
            weight: images.map(weight).collect(),
            model_px: stand.noise.unwhiten(&evidence.images, &evidence.place, &model).chunks_exact(2).map(|p| [p[0], p[1]]).collect(),
            scatter: stand.fit.c.sqrt() / d,
        }
    }

    /// Images in order of a value, cut into bins of equal numbers.
    fn in_order(&self, value: impl Fn(usize) -> f64) -> Vec<Vec<usize>> {
        let mut order: Vec<usize> = self.taken.iter().copied().filter(|k| value(*k).is_finite()).collect();
        ascending(&mut order, |a| value(*a));
        order.chunks(order.len().div_ceil(BINS).max(1)).map(<[usize]>::to_vec).collect()
    }

    fn along(&self, k: usize, component: &dyn Fn(usize) -> [f64; 2]) -> f64 {
        let [a, b] = component(k);
        self.model_px[k][0] * a + self.model_px[k][1] * b
    }

    /// Share of what tells the effect's size that the bins' means of a component hold.
    fn told(&self, bins: &[Vec<usize>], component: &dyn Fn(usize) -> [f64; 2]) -> f64 {
        let all: f64 = self.taken.iter().map(|k| self.square[*k]).sum();
        let of = |bin: &Vec<usize>| {
            let weights: f64 = bin.iter().map(|k| self.weight[*k]).sum();
            bin.iter().map(|k| self.weight[*k] * self.along(*k, component)).sum::<f64>().powi(2) / weights
        };
        bins.iter().map(of).sum::<f64>() / all.max(f64::MIN_POSITIVE)
    }

    /// One bin at the mean of a value; the model's sign is that of its mean component.
    fn bin(&self, bin: &[usize], value: impl Fn(usize) -> f64, component: Option<&dyn Fn(usize) -> [f64; 2]>) -> Option<ProfileBin> {
        let sum = |of: &dyn Fn(usize) -> f64| bin.iter().map(|k| of(*k)).sum::<f64>();
        let (square, weights) = (sum(&|k| self.square[k]), sum(&|k| self.weight[k]));
        if square <= 0.0 || weights <= 0.0 {
            return None;
        }
        let sign = component.map_or(1.0, |component| if sum(&|k| self.weight[k] * self.along(k, component)) < 0.0 { -1.0 } else { 1.0 });
        let length = sum(&|k| self.weight[k] * (self.model_px[k][0].powi(2) + self.model_px[k][1].powi(2))) / weights;
        let model = sign * length.sqrt();
        let amplitude = 1.0 + sum(&|k| self.product[k]) / square;
        Some(ProfileBin {
            at: sum(&|k| self.weight[k] * value(k)) / weights,
            mean: amplitude * model,
            sigma: self.scatter / square.sqrt() * length.sqrt(),
            model,
            stars: bin.len(),
        })
    }
}

/// The parameter that is drawn: of those that are sizes (nought is no effect) the best determined.
fn drawn_parameter(solved: &FinalFit, k: usize, found: &[FoundParameter]) -> Option<usize> {
    let hypothesis = &solved.evidence.hypotheses[solved.entries[k].hypothesis];
    let searched = hypothesis.searched.as_ref().map(|searched| searched.parameter);
    let is_size = |j: &usize| Some(hypothesis.fitted[*j]) != searched && !found[*j].name.starts_with("zenith");
    let count = hypothesis.fitted.len().min(hypothesis.variants.first()?.columns.len()).min(found.len());
    let snr = |j: &usize| found[*j].value.abs() / found[*j].sigma;
    (0..count).filter(is_size).filter(|j| snr(j).is_finite()).max_by(|a, b| snr(a).total_cmp(&snr(b)))
}

/// The profiles of findings, `standing` their entries.
pub(super) fn profiles(context: &Context, solved: &FinalFit, standing: &[usize], found: &[Finding]) -> Vec<Profile> {
    let of = |(k, finding): (&usize, &Finding)| profile(context, solved, *k, &finding.parameters, &finding.located_by);
    standing.iter().zip(found).filter_map(of).collect()
}

/// The profile of entry `k`, with the names of the covariates that located it. `found`: its parameters as the finding has them.
fn profile(context: &Context, solved: &FinalFit, k: usize, found: &[FoundParameter], located_by: &[String]) -> Option<Profile> {
    let effect = solved.evidence.hypotheses[solved.entries.get(k)?.hypothesis].effect;
    let id = effect.id();
    let j = drawn_parameter(solved, k, found)?;
    let drawn = Drawn::new(solved, k, j, found[j].value);
    let evidence = drawn.evidence;
    let camera = context.joint.model().camera();
    let middle = [(camera.width_px as f64 - 1.0) / 2.0, (camera.height_px as f64 - 1.0) / 2.0];
    let places: Vec<[f64; 2]> = evidence.predicted_px(REACH_PX).collect();
    let radial = |k: usize| {
        let (x, y) = (places[k][0] - middle[0], places[k][1] - middle[1]);
        let r = x.hypot(y).max(1e-9);
        [x / r, y / r]
    };
    let all: f64 = drawn.taken.iter().map(|k| drawn.square[*k]).sum();
    let wanted = effect.facts().profile_covariate(&found[j].name).into_iter().chain(located_by.iter().map(String::as_str));
    for name in wanted.filter(|name| !matches!(*name, "field-map" | "star")) {
        let Some(covariate) = evidence.covariates.iter().find(|covariate| covariate.name == name) else { continue };
        let value = |k: usize| covariate.values[k];
        let bins = drawn.in_order(value);
        let known: f64 = bins.iter().flatten().map(|k| drawn.square[*k]).sum();
        let own = |k: usize| covariate.direction.as_ref().map_or([0.0; 2], |direction| direction[k]);
        let components: [Component; 5] = [
            ("along its own direction", &own),
            ("along the radius", &radial),
            ("along x", &|_| [1.0, 0.0]),
            ("along y", &|_| [0.0, 1.0]),
            ("across the radius", &|k| {
                let [x, y] = radial(k);
                [-y, x]
            }),
        ];
        let told = components.into_iter().map(|(words, component)| (drawn.told(&bins, component), words, component));
        let Some((share, words, component)) = told.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        if share < TELLS || known < KNOWN * all {
            continue;
        }
        let toward = match (name, words) {
            ("zenith", "along its own direction") => "toward the zenith",
            ("proper-motion", "along its own direction") => "along the star's proper motion",
            _ => words,
        };
        let bins = bins.iter().filter_map(|bin| drawn.bin(bin, value, Some(component))).collect();
        return Some(profile_of(id, &found[j], name, toward, bins));
    }
    // Against how far the effect displaces each image: bins that tell alike.
    let size = |k: usize| drawn.model_px[k][0].hypot(drawn.model_px[k][1]);
    let mut order = drawn.taken.clone();
    ascending(&mut order, |a| size(*a));
    let mut bins: Vec<Vec<usize>> = vec![Vec::new(); BINS];
    let mut sum = 0.0;
    for k in order {
        bins[((sum / all.max(f64::MIN_POSITIVE) * BINS as f64) as usize).min(BINS - 1)].push(k);
        sum += drawn.square[k];
    }
    let bins = bins.iter().filter_map(|bin| drawn.bin(bin, size, None)).collect();
    Some(profile_of(id, &found[j], PREDICTED, "along what it predicts", bins))
}

fn profile_of(id: &str, parameter: &FoundParameter, covariate: &str, component: &str, bins: Vec<ProfileBin>) -> Profile {
    Profile { id: id.to_owned(), parameter: parameter.clone(), covariate: covariate.to_owned(), component: component.to_owned(), bins }
}
