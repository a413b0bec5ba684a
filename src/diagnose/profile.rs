//! The data of a picture: residuals with everything but one effect modelled, against the covariate that located it, and the effect
//! through them.

use super::attribute::columns;
use super::diagnosis::Profile;
use super::findings::Context;

/// Bins of equal counts.
const BINS: usize = 12;

/// A direction on the frame at every star image, and its name.
type Component<'a> = (&'static str, &'a dyn Fn(usize) -> [f64; 2]);

/// The profile of entry `k`, with the names of the covariates that located it.
pub(super) fn profile(context: &Context, k: usize, located_by: &[String]) -> Option<Profile> {
    let evidence = context.evidence;
    let entry = context.entries[k];
    let hypothesis = &evidence.hypotheses[entry.hypothesis];
    let first = context.with_all.sheet.camera.len()
        + context.entries[..k]
            .iter()
            .map(|entry| evidence.hypotheses[entry.hypothesis].variants[entry.variant].columns.len())
            .sum::<usize>();
    // The residual falls by the effect: what it displaces is minus its columns times their sizes.
    let mut moved = vec![[0.0; 2]; evidence.images.len()];
    for (j, column) in columns(evidence, &[entry]).enumerate() {
        for (moved, value) in moved.iter_mut().zip(column) {
            for axis in 0..2 {
                moved[axis] -= context.with_all.fit.change[first + j] * value[axis];
            }
        }
    }
    let residual_px = context.with_all.noise.unwhiten(&evidence.images, &evidence.place, &context.with_all.fit.residual);
    let located = ranked_name(context, k, located_by)?;
    let covariate = evidence.covariates.iter().find(|covariate| covariate.name == located)?;
    let camera = context.joint.model().camera();
    let middle = [(camera.width_px as f64 - 1.0) / 2.0, (camera.height_px as f64 - 1.0) / 2.0];
    let places: Vec<[f64; 2]> = evidence.predicted_px(super::evidence::REACH_PX).collect();
    let radial = |k: usize| {
        let (x, y) = (places[k][0] - middle[0], places[k][1] - middle[1]);
        let r = x.hypot(y).max(1e-9);
        [x / r, y / r]
    };
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
    let taken: Vec<usize> = (0..moved.len()).filter(|k| context.with_all.take[*k] && covariate.values[*k].is_finite()).collect();
    let power = |component: &dyn Fn(usize) -> [f64; 2]| -> f64 {
        taken
            .iter()
            .map(|k| {
                let [a, b] = component(*k);
                (moved[*k][0] * a + moved[*k][1] * b).powi(2)
            })
            .sum()
    };
    let (name, component) = components.into_iter().max_by(|a, b| power(a.1).total_cmp(&power(b.1)))?;
    let mut order = taken;
    order.sort_by(|a, b| covariate.values[*a].total_cmp(&covariate.values[*b]));
    let mut bins = Vec::new();
    for bin in order.chunks(order.len().div_ceil(BINS).max(1)) {
        let mut sums = [0.0; 4];
        for k in bin {
            let [a, b] = component(*k);
            let sigma = context.with_all.noise.sigma_px(&evidence.images[*k], evidence.place[*k]);
            let weight = 1.0 / (sigma * sigma);
            let model = moved[*k][0] * a + moved[*k][1] * b;
            let seen = residual_px[2 * k] * a + residual_px[2 * k + 1] * b + model;
            for (sum, value) in sums.iter_mut().zip([1.0, covariate.values[*k], seen, model]) {
                *sum += weight * value;
            }
        }
        bins.push([sums[1] / sums[0], sums[2] / sums[0], (1.0 / sums[0]).sqrt(), sums[3] / sums[0]]);
    }
    let toward = match (covariate.name.as_str(), name) {
        ("zenith", "along its own direction") => "toward the zenith",
        ("proper-motion", "along its own direction") => "along the star's proper motion",
        _ => name,
    };
    Some(Profile { id: hypothesis.id().to_owned(), covariate: located, component: toward.to_owned(), bins })
}

/// The covariate that located the finding, of those that can be drawn as a number.
fn ranked_name(context: &Context, k: usize, located_by: &[String]) -> Option<String> {
    let drawn = |name: &String| name != "field-map";
    // Those that located it are the first of all.
    located_by.iter().find(|name| drawn(name)).cloned().or_else(|| context.located_names(k).into_iter().find(drawn))
}
