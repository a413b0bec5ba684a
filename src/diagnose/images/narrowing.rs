//! Effects of which parts are a cause of their own: the part stands for the whole where it says as much, and a part with another effect where those two
//! say more.

use super::row_fit::RowFit;
use super::rows::{Question, Rows};
use super::selection::{AS_GOOD, answer, answers, columns, cosine, fitted};
use crate::statistics::order::sort_by_key;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer parameters say as much where what they leave is that of chance in more than one of ten (as −ln).
const AS_CHANCE: f64 = 2.3;
/// A whole that was chosen for another effect shares so much of its trace.
const SHARED: f64 = 0.5;

/// Whether a question is a part of another.
fn is_part_of(part: &Question, whole: &Question) -> bool {
    part.is_part && !whole.is_part && part.id == whole.id && part.parameters.iter().all(|own| whole.parameters.contains(own))
}

/// The parts of an effect's question that may stand in its place, the smallest first.
fn parts_of(rows: &Rows, whole: usize) -> Vec<usize> {
    let of = |index: usize| &rows.questions[index];
    let mut parts: Vec<usize> = (0..rows.questions.len()).filter(|part| is_part_of(of(*part), of(whole))).collect();
    sort_by_key(&mut parts, |part| of(*part).columns.len());
    parts
}

/// With wholes in the place of their parts.
fn widened(rows: &Rows, accepted: &[usize]) -> Vec<usize> {
    let whole_of =
        |part: usize| (0..rows.questions.len()).find(|whole| is_part_of(&rows.questions[part], &rows.questions[*whole])).unwrap_or(part);
    let mut all: Vec<usize> = Vec::new();
    for whole in accepted.iter().map(|index| whole_of(*index)) {
        if !all.contains(&whole) {
            all.push(whole);
        }
    }
    all
}

/// With the smallest parts that say as much as the wholes (odds of 100 : 1): a square beside a slope that nothing asks for spoils every place beyond the
/// data, and one that is there is no finding by itself.
pub(super) fn narrowed(rows: &Rows, allowed: &[bool], (found, given): (Vec<usize>, usize), fit: RowFit) -> (Vec<usize>, RowFit) {
    let mut accepted = found[..given].to_vec();
    accepted.extend(widened(rows, &found[given..]));
    let mut fit = if accepted == found { fit } else { fitted(rows, allowed, &accepted, None) };
    for k in given..accepted.len() {
        let whole = accepted[k];
        for part in parts_of(rows, whole) {
            let mut others = accepted.clone();
            others[k] = part;
            let without = RowFit::under(rows, &fit.take, &columns(rows, &others), &fit);
            let rise: f64 = without.fall_to(rows, &fit).0.iter().sum();
            let dropped = rows.questions[whole].columns.len() - rows.questions[part].columns.len();
            if neg_ln_chi2_sf(dropped as f64, rise.max(0.0)) < AS_GOOD {
                accepted = others;
                fit = fitted(rows, allowed, &accepted, None);
                break;
            }
        }
    }
    (accepted, fit)
}

/// A step by step selection takes the whole of an effect for the sum of a part of it and of another effect, whose rest is then too little to be seen: a
/// tilt and a coma are together an image that follows the field. With such a part and the other effect in the place of the whole, where they say more
/// (odds of 100 : 1 for all that are tried and for the parameters that are asked for), or where part and first parameter of the other say as much and are
/// fewer than the parameters of the whole that are needed.
pub(super) fn exchanged(
    rows: &Rows,
    allowed: &[bool],
    (found, given): (Vec<usize>, usize),
    fit: RowFit,
    threshold: f64,
) -> (Vec<usize>, RowFit) {
    let (mut accepted, mut fit) = (found, fit);
    for k in given..accepted.len() {
        let whole = accepted[k];
        let parts: Vec<usize> = (0..rows.questions.len()).filter(|part| is_smaller(rows, *part, whole)).collect();
        let least = AS_GOOD + (parts.len().max(1) as f64).ln();
        let needed = if parts.is_empty() { 0 } else { needed(rows, &fit, &accepted, k) };
        let count = |all: &[usize]| columns(rows, all).len() as f64;
        let instead = |part: usize| {
            let mut others = accepted.clone();
            others[k] = part;
            let without = RowFit::under(rows, &fit.take, &columns(rows, &others), &fit);
            let is_another = |question: usize| rows.questions[question].id != rows.questions[whole].id;
            let beside = answers(rows, &without, &others);
            let best = beside
                .iter()
                .filter(|own| is_another(own.question) && own.surprise > threshold)
                .max_by(|a, b| a.surprise.total_cmp(&b.surprise).then(a.statistic.total_cmp(&b.statistic)))?;
            let fall = |columns: &[&Vec<f64>]| -> f64 {
                let both = RowFit::under(rows, &fit.take, columns, &fit);
                fit.fall_to(rows, &both).0.iter().sum()
            };
            let mut with_one = columns(rows, &others);
            with_one.push(&rows.questions[best.question].columns[0]);
            let fewer = needed as f64 - rows.questions[part].columns.len() as f64 - 1.0;
            let dropped = count(&accepted) - with_one.len() as f64;
            let is_as_good = fewer > 0.0 && neg_ln_chi2_sf(dropped, (-fall(&with_one)).max(0.0)) < AS_CHANCE;
            others.push(best.question);
            let all = fall(&columns(rows, &others));
            let surprise = neg_ln_chi2_sf((count(&others) - count(&accepted)).max(1.0), all.max(0.0));
            let surprise = if surprise > least { surprise } else { 0.0 };
            (surprise > 0.0 || is_as_good).then_some(([surprise, fewer, all], others))
        };
        let by_merit = |(a, _): &([f64; 3], Vec<usize>), (b, _): &([f64; 3], Vec<usize>)| {
            a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
        };
        let better = parts.into_iter().filter_map(instead).max_by(by_merit);
        let Some((_, others)) = better else { continue };
        // Both must be beyond chance beside each other.
        let stand = [k, others.len() - 1].into_iter().all(|own| {
            let mut rest = others.clone();
            let tried = rest.remove(own);
            let without = fitted(rows, allowed, &rest, None);
            answer(rows, &without, tried).is_some_and(|answer| answer.surprise > threshold)
        });
        if stand {
            fit = fitted(rows, allowed, &others, None);
            accepted = others;
        }
    }
    (accepted, fit)
}

/// How many parameters of an accepted effect are needed, the least needed being left out first while the others say as much (odds of 100 : 1).
fn needed(rows: &Rows, fit: &RowFit, accepted: &[usize], k: usize) -> usize {
    let own = &rows.questions[accepted[k]].columns;
    let others: Vec<usize> = accepted.iter().copied().filter(|other| *other != accepted[k]).collect();
    let mut kept: Vec<usize> = (0..own.len()).collect();
    while kept.len() > 1 {
        let rise = |left_out: usize| -> f64 {
            let mut columns = columns(rows, &others);
            columns.extend(kept.iter().filter(|column| **column != left_out).map(|column| &own[*column]));
            RowFit::under(rows, &fit.take, &columns, fit).fall_to(rows, fit).0.iter().sum()
        };
        let rises = kept.iter().map(|column| (rise(*column), *column));
        let Some((rise, least)) = rises.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        let dropped = own.len() - kept.len() + 1;
        if neg_ln_chi2_sf(dropped as f64, rise.max(0.0)) >= AS_GOOD {
            break;
        }
        kept.retain(|column| *column != least);
    }
    kept.len()
}

/// What a part of the rows has chosen, with the part of an effect and the other effect that all rows have in the place of the whole, if those explain
/// these rows about as well: fewer rows do not tell which it is, and what leaves the same trace is credited alike. `beside`: the fit with what is given alone.
pub(super) fn as_in_all_rows(
    rows: &Rows,
    beside: &RowFit,
    (chosen, given): (Vec<usize>, usize),
    fit: RowFit,
    found: &[usize],
) -> (Vec<usize>, RowFit) {
    let is_open = |own: &usize| !found.contains(own);
    let Some((k, part)) = (given..chosen.len()).filter(|k| is_open(&chosen[*k])).find_map(|k| {
        let part = found.iter().find(|part| is_smaller(rows, **part, chosen[k]))?;
        Some((k, *part))
    }) else {
        return (chosen, fit);
    };
    let of = |index: usize| rows.questions[index].id;
    let is_other = |own: &usize| !chosen.contains(own) && of(*own) != of(part) && cosine(rows, beside, *own, chosen[k]) > SHARED;
    let others: Vec<usize> = found.iter().copied().filter(is_other).collect();
    let mut instead = chosen.clone();
    instead[k] = part;
    // Another question about the same effect makes room.
    instead.retain(|own| found.contains(own) || !others.iter().any(|other| of(*other) == of(*own)));
    instead.extend(&others);
    let both = RowFit::under(rows, &fit.take, &columns(rows, &instead), &fit);
    let fall: f64 = fit.fall_to(rows, &both).0.iter().sum();
    if others.is_empty() || fall < -AS_GOOD { (chosen, fit) } else { (instead, both) }
}

/// Whether a question is about a part of what another is about, which may be a part itself.
fn is_smaller(rows: &Rows, part: usize, whole: usize) -> bool {
    let [part, whole] = [part, whole].map(|index| &rows.questions[index]);
    part.is_part
        && part.id == whole.id
        && part.columns.len() < whole.columns.len()
        && part.parameters.iter().all(|own| whole.parameters.contains(own))
}

#[cfg(test)]
mod tests {
    use super::super::judge::judge;
    use super::super::tests::{FRAMES, asked, found, nothing, stars};
    use crate::effects::ImageContext;

    /// Names where the images have these second moments and skewness.
    fn told(seed: u64, added: impl Fn(&ImageContext) -> ([f64; 3], [f64; 2])) -> Vec<&'static str> {
        let mut stars = stars(seed, nothing);
        for star in &mut stars {
            let (second_px2, skewness) = added(&star.image);
            let moments = star.moments.as_mut().unwrap();
            (0..3).for_each(|k| moments.second_px2[k] += second_px2[k]);
            (0..2).for_each(|k| moments.skewness[k] += skewness[k]);
        }
        found(&judge(&stars, None, FRAMES, &asked(1e-3), &[]).unwrap())
    }

    fn tilted([u, v]: [f64; 2]) -> f64 {
        0.03 * v - 0.02 * u
    }

    /// Coma draws images out along the radius as a curved focal surface with astigmatism does, and its tails are small.
    #[test]
    fn a_tilt_beside_coma_is_no_other_focal_surface() {
        let added = |image: &ImageContext| {
            let ([u, v], wider) = (image.at, tilted(image.at));
            let (square, across) = (0.12, (u * u + v * v) / 6.0);
            let drawn = [across + u * u / 3.0, u * v / 3.0, across + v * v / 3.0].map(|own| square * own);
            ([drawn[0] + wider, drawn[1], drawn[2] + wider], [0.03 * u, 0.03 * v])
        };
        let names: Vec<_> = (40..45)
            .map(|seed| {
                let mut names = told(seed, added);
                names.sort_unstable();
                names
            })
            .collect();
        let right = names.iter().filter(|names| **names == ["coma", "psf-shape"]).count();
        assert!(right >= 4, "{names:?}");
    }

    /// Without a tilt too, and with tails too small to be seen: the sizes of a curvature and an astigmatism that do the same are two.
    #[test]
    fn coma_alone_is_no_focal_surface() {
        let added = |image: &ImageContext| {
            let [u, v] = image.at;
            let across = (u * u + v * v) / 6.0;
            ([across + u * u / 3.0, u * v / 3.0, across + v * v / 3.0].map(|own| 0.12 * own), [0.0; 2])
        };
        let names: Vec<_> = (50..56).map(|seed| told(seed, added)).collect();
        let right = names.iter().filter(|names| **names == ["coma"]).count();
        assert!(right >= 5, "{names:?}");
    }

    /// The same without tails, and with any ratio of curvature and astigmatism but that of coma, whose images are drawn out along the radius by three times
    /// as much as across it: a focal surface within 0.3 rad of it (in the plane of the two) is a coma with fewer parameters, unless its size tells.
    #[test]
    fn another_focal_surface_is_no_coma_beside_a_tilt() {
        const SURFACES: usize = 12;
        let coma = 0.5_f64.atan();
        let names: Vec<_> = (0..SURFACES)
            .map(|k| {
                let angle = coma + 0.3 + (std::f64::consts::PI - 0.6) * (k as f64 + 0.5) / SURFACES as f64;
                let (curved, drawn) = (0.06 * angle.cos(), 0.06 * angle.sin());
                let added = |image: &ImageContext| {
                    let [u, v] = image.at;
                    let wider = tilted(image.at) + curved * (u * u + v * v);
                    let along = drawn * (u * u - v * v);
                    ([wider + along, 2.0 * drawn * u * v, wider - along], [0.0; 2])
                };
                told(60 + k as u64, added)
            })
            .collect();
        let right = names.iter().filter(|names| **names == ["psf-shape"]).count();
        assert!(right + 1 >= SURFACES, "{names:?}");
    }
}
