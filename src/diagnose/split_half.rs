//! Split-half validation: an effect with opposite sign in two random halves is null by construction, so its p-values must be uniform.
//!
//! Whatever is in the frames is in both random halves of them; an effect that is in one half only, or has the other sign there, is due to chance.
//! The whole procedure is run for such effects, split after split. The p-values are uniform if errors are as the diagnosis takes them (independent,
//! of the sizes that it has found).
//!
//! Splits of one night share its errors: if its brightest star is off by chance it is so in every split, and the p-values of a single night are not
//! uniform. The spread that this allows is found from simulated nights with such errors, split in the same way.

use std::collections::BTreeMap;

use super::diagnosis::HalfNights;
use super::final_fit::FinalFit;
use super::null_distribution::family_p;
use super::options::DiagnoseOptions;
use super::scan::{Asks, Scan};
use crate::parallel;
use crate::statistics::order::sort_by;
use rand::{SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64Mcg;

/// Simulations of each split.
const NULLS: usize = 200;
/// Fewer frames have too few different halves.
pub(super) const MIN_FRAMES: usize = 6;
/// Nights simulated.
const NIGHTS: usize = 199;

/// What one split says: the p-value of the night, of which effect, and the p-values of the simulated nights.
struct Split {
    p_value: f64,
    id: &'static str,
    simulated: Vec<f64>,
}

/// p-values of effects that change sign between random halves of the frames, beside the whole model.
pub(super) fn half_nights(solved: &FinalFit, options: &DiagnoseOptions) -> Option<HalfNights> {
    let frames = solved.evidence.frames.len();
    if options.half_nights == 0 || frames < MIN_FRAMES {
        return None;
    }
    let nights_seed = options.seed ^ 0x0068_616c_7665_735f;
    let mut splits: Vec<Split> = parallel::map_numbers(options.half_nights, |split| {
        let seed = options.seed ^ (split as u64 + 1).wrapping_mul(0xd134_2543_de82_ef95);
        let mut order: Vec<usize> = (0..frames).collect();
        order.shuffle(&mut Pcg64Mcg::seed_from_u64(seed));
        let mut sign = vec![1.0; frames];
        for place in &order[..frames / 2] {
            sign[*place] = -1.0;
        }
        let mut evidence = solved.evidence.clone();
        for column in
            evidence.hypotheses.iter_mut().flat_map(|hypothesis| &mut hypothesis.variants).flat_map(|variant| &mut variant.columns)
        {
            for (value, place) in column.iter_mut().zip(&evidence.stars.place) {
                *value = value.map(|component| component * sign[*place]);
            }
        }
        evidence.covariates = std::sync::Arc::default();
        let stand = &solved.stand;
        let scan = Scan::new(&evidence, &stand.noise, &stand.system, &stand.fit, |_| true);
        let of = |group: &super::scan::Group| match group.asks {
            Asks::Hypothesis(index, _) => (group.surprise(), solved.evidence.hypotheses[index].id()),
            Asks::Covariate(_) => (0.0, ""),
        };
        let (most, id) = scan.groups.iter().map(of).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
        let reference = scan.chance(&stand.fit, &stand.take, seed, 0, NULLS).hypotheses;
        let [nights, _] = scan.simulated(&stand.fit, &stand.take, nights_seed, 0, NIGHTS);
        let simulated = nights.into_iter().map(|most| family_p(&reference, most)).collect();
        Split { p_value: family_p(&reference, most), id, simulated }
    });
    sort_by(&mut splits, |a, b| a.p_value.total_cmp(&b.p_value).then(a.id.cmp(b.id)));
    let p_values: Vec<f64> = splits.iter().map(|split| split.p_value).collect();
    let mut largest: BTreeMap<String, usize> = BTreeMap::new();
    for split in &splits {
        *largest.entry(split.id.to_owned()).or_default() += 1;
    }
    let ks_distance = from_uniform(p_values.clone());
    let as_far =
        (0..NIGHTS).filter(|night| from_uniform(splits.iter().map(|split| split.simulated[*night]).collect()) >= ks_distance).count();
    Some(HalfNights { ks_p_value: (as_far as f64 + 1.0) / (NIGHTS as f64 + 1.0), ks_distance, p_values, largest })
}

/// Largest distance of the distribution of p-values from the uniform one.
fn from_uniform(mut p_values: Vec<f64>) -> f64 {
    p_values.sort_by(f64::total_cmp);
    let n = p_values.len() as f64;
    let distance = |(k, p): (usize, &f64)| ((k as f64 + 1.0) / n - p).max(p - k as f64 / n);
    p_values.iter().enumerate().map(distance).fold(0.0, f64::max)
}
