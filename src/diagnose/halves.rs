//! Are the p-values of this recording to be trusted? Whatever is in the frames is in both halves of them, drawn by lot; an effect that is there
//! in one half and not in the other, or with the other sign, is there by chance alone. So the whole procedure is asked of such effects, split
//! after split: where errors are as the diagnosis takes them (independent, of the sizes it has found) the p-values are uniform.

use std::collections::BTreeMap;

use rand::{SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::DiagnoseOptions;
use super::chance::family_p;
use super::diagnosis::HalfNights;
use super::findings::Solved;
use super::scan::{Asks, Scan};
use crate::statistics::significance::kolmogorov_p;

/// Simulations of each split.
const NULLS: usize = 200;
/// Fewer frames have too few different halves.
const FEWEST_FRAMES: usize = 6;

/// p-values of effects that change sign between random halves of the frames, beside the whole model.
pub(super) fn half_nights(solved: &Solved, options: &DiagnoseOptions) -> Option<HalfNights> {
    let frames = solved.evidence.frames.len();
    if options.half_nights == 0 || frames < FEWEST_FRAMES {
        return None;
    }
    let mut tested: Vec<(f64, &'static str)> = (0..options.half_nights)
        .into_par_iter()
        .map(|split| {
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
                for (value, place) in column.iter_mut().zip(&evidence.place) {
                    *value = value.map(|component| component * sign[*place]);
                }
            }
            evidence.covariates = std::sync::Arc::default();
            let stand = &solved.stand;
            let scan = Scan::new(&evidence, &stand.noise, &stand.sheet, &stand.fit, |_| true);
            let of = |group: &super::scan::Group| match group.asks {
                Asks::Hypothesis(index, _) => (group.surprise(), solved.evidence.hypotheses[index].id()),
                Asks::Covariate(_) => (0.0, ""),
            };
            let (most, id) = scan.groups.iter().map(of).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default();
            (family_p(&scan.chance(&stand.fit, &stand.take, seed, 0, NULLS).hypotheses, most), id)
        })
        .collect();
    tested.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let p_values: Vec<f64> = tested.iter().map(|(p, _)| *p).collect();
    let mut largest: BTreeMap<String, usize> = BTreeMap::new();
    for (_, id) in &tested {
        *largest.entry((*id).to_owned()).or_default() += 1;
    }
    let n = p_values.len() as f64;
    let distance = |(k, p): (usize, &f64)| ((k as f64 + 1.0) / n - p).max(p - k as f64 / n);
    let ks_distance = p_values.iter().enumerate().map(distance).fold(0.0, f64::max);
    Some(HalfNights { ks_p_value: kolmogorov_p(p_values.len(), ks_distance), ks_distance, p_values, largest })
}
