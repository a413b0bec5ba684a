//! The unexplained remainder: its map, the covariates that it follows, and the effects that it resembles.

use super::channels::Channel;
use super::cross_validation::Withheld;
use super::diagnosis::{Resemblance, Unknown};
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect};
use super::omnibus::{Omnibus, among_covariates};
use super::residual_field::{Left, map};
use super::resolved::{least_p, told};
use super::scan::{Asks, Scan};
use super::stepwise::is_observable;
use crate::calibrate::BundleSolution;
use crate::statistics::order::{descending, sort_by_key};

/// Covariates named at most.
const NAMED: usize = 3;
/// What is left looks like an effect from this cosine on.
const ALIKE: f64 = 0.9;
/// Parts that the map is made without in turn, to be judged on.
const PARTS: usize = 4;
/// Nearest relatives named at most.
const RELATIVES: usize = 4;

/// The unknown part, beside the findings that stand.
pub(super) fn unknown(evidence: &Evidence, stand: &FitState, vetoed: &[Withheld], test: &Omnibus, joint: &BundleSolution) -> Unknown {
    let scan = Scan::new(evidence, &stand.noise, &stand.system, &stand.fit, |_| true);
    let mut covariates: Vec<(usize, f64)> = Vec::new();
    let mut effects: Vec<(usize, f64)> = Vec::new();
    let mut most_explained = 0.0_f64;
    for group in &scan.groups {
        let surprise = group.surprise();
        let explained = (group.statistic - group.rank as f64).max(0.0);
        most_explained = most_explained.max(explained);
        let (list, index, value) = match group.asks {
            Asks::Covariate(index) => (&mut covariates, index, surprise),
            Asks::Hypothesis(index, _) => (&mut effects, index, explained),
        };
        match list.iter_mut().find(|(known, _)| *known == index) {
            Some((_, most)) => *most = most.max(value),
            None => list.push((index, value)),
        }
    }
    descending(&mut covariates, |a| a.1);
    descending(&mut effects, |a| a.1);
    let mut located_by: Vec<String> = Vec::new();
    for (index, surprise) in &covariates {
        let p = among_covariates(&test.chance, *surprise);
        if located_by.is_empty() || (located_by.len() < NAMED && p < 0.01) {
            located_by.push(evidence.covariates[*index].name.clone());
        }
    }
    let mut resembles: Vec<Resemblance> = effects
        .iter()
        .filter(|(index, explained)| {
            *explained > 0.0 && most_explained > 0.0 && is_observable(evidence, stand, SelectedEffect { hypothesis: *index, variant: 0 })
        })
        .map(|(index, explained)| Resemblance {
            id: evidence.hypotheses[*index].id().to_owned(),
            cos: (explained / most_explained).sqrt().min(1.0),
        })
        .take(RELATIVES)
        .collect();
    // Names that were tried and vetoed stand first.
    let is_vetoed = |id: &str| vetoed.iter().any(|own| evidence.hypotheses[own.entry.hypothesis].id() == id);
    sort_by_key(&mut resembles, |resemblance| !is_vetoed(&resemblance.id));
    let residual_px = stand.noise.unwhiten(&evidence.images, &evidence.place, &stand.fit.residual);
    let places: Vec<[f64; 2]> = evidence.predicted_px(super::star_images::REACH_PX).collect();
    let of = |k: usize| -> Left {
        let sigma = stand.noise.sigma_px(&evidence.images[k], evidence.place[k]);
        (places[k], [residual_px[2 * k], residual_px[2 * k + 1]], sigma)
    };
    let taken: Vec<usize> = (0..places.len()).filter(|k| stand.take[*k]).collect();
    // Judged on frames that it was not made of; on stars where there is but one frame.
    let part = |k: usize| if evidence.frames.len() > 1 { evidence.place[k] % PARTS } else { evidence.star[k] % PARTS };
    let left: Vec<(Left, usize)> = taken.into_iter().map(|k| (of(k), part(k))).collect();
    let camera = joint.model().camera();
    let size = [camera.width_px as f64, camera.height_px as f64];
    let field = map(&left, size);
    let unknown = Unknown {
        channel: Channel::Astrometry,
        located_by,
        p_value: test.p_value,
        p_value_is: None,
        resembles,
        vetoes: vetoed
            .iter()
            .map(|own| format!("{}: {}", evidence.hypotheses[own.entry.hypothesis].id(), own.against.join("; ")))
            .collect(),
        map: None,
        field,
        sentence: String::new(),
    };
    let sentence = sentence(&unknown, evidence, vetoed, test);
    Unknown { sentence, ..unknown }
}

/// The unknown part in words.
fn sentence(unknown: &Unknown, evidence: &Evidence, vetoed: &[Withheld], test: &Omnibus) -> String {
    let Unknown { resembles, field, .. } = unknown;
    let id_of = |own: &Withheld| evidence.hypotheses[own.entry.hypothesis].id();
    let relatives: Vec<String> = resembles.iter().map(|r| format!("{} (cos {:.2})", r.id, r.cos)).collect();
    let follows = unknown.located_by.join(", ");
    let p = told(test.p_value, least_p(test.chance.nulls));
    let nearest = resembles.first().filter(|nearest| nearest.cos > ALIKE);
    let tried = nearest.and_then(|nearest| vetoed.iter().find(|own| id_of(own) == nearest.id));
    let mut sentence = match tried {
        Some(own) => {
            let against = own.against.join("; ");
            format!("In the positions something is left ({p}) that looks like {}, but {against}; it follows {follows}", id_of(own))
        }
        None => format!("In the positions something is left that no effect of the registry explains ({p}); it follows {follows}"),
    };
    if !relatives.is_empty() {
        sentence += &format!("; most like it are {}", relatives.join(", "));
    }
    if field.is_told() {
        sentence += &format!(
            ". Its map over the field has an rms of {:.3} px on a scale of {:.0} px, {:.0} % of it free of curl",
            field.rms_px,
            field.length_px,
            100.0 * field.curl_free_share
        );
    }
    sentence.push('.');
    sentence
}
