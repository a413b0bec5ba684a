//! Columns that are rendered: as of stars alone, as of the formulas, and found in light and shape.

use super::super::expected_stars::StarMeasurement;
use super::super::judge::{Asked, judge};
use super::super::rows::Rows;
use super::super::stars::rows_of_stars;
use super::super::tests::{FRAMES, asked, found, nothing, size, stars as drawn};
use super::*;
use crate::effects::detector::charge_transfer_inefficiency::ChargeTransferInefficiency;
use crate::effects::detector::overshoot::Overshoot;

const SIDE_PX: usize = 512;
const GAIN_E_PER_DN: f64 = 2.0;

fn stamps() -> StampCamera {
    let camera = Camera::pinhole(SIDE_PX, SIDE_PX, 2000.0);
    let looks = ImageConditions { psf_sigma_px: 1.0, background_e: 40.0, noise_e: 8.0 };
    StampCamera { camera, gain_e_per_dn: GAIN_E_PER_DN, looks }
}

/// Stars of which nothing is missing, as the rows expect them.
fn expected(stars: &[StarMeasurement]) -> Vec<ExpectedStar> {
    super::super::expected_stars::expected_bright(stars)
}

fn numbers(response: &ImageResponse) -> [f64; 6] {
    let ([xx, xy, yy], [x, y]) = (response.second_px2, response.skewness);
    [response.magnitude, xx, xy, yy, x, y]
}

/// What a unit does to a star that shares its frame with others is what it does to one that has a frame for itself: of 200 stars, each of the six
/// numbers to 5 % of its root mean square.
#[test]
fn stars_that_share_a_frame_change_as_stars_alone() {
    let all = drawn(11, nothing);
    let stars: Vec<ExpectedStar> = expected(&all).into_iter().take(200).collect();
    assert_eq!(stars.len(), 200);
    let stamps = stamps();
    let bench = Bench::new(&stars, &stamps).unwrap();
    assert!(bench.plates.len() < 12, "{} frames for 200 stars", bench.plates.len());
    let alone: Vec<StarLayout> = bench.plates.iter().flatten().map(|star| vec![*star]).collect();
    for id in ["overshoot", "charge-transfer-inefficiency"] {
        let effect = DISPLACEMENTS.iter().find(|effect| effect.id() == id).unwrap();
        let pair = bench.pair(&effect.rendering(0).unwrap()).unwrap();
        let shared = bench.difference(&pair, &bench.plates).unwrap();
        let apart = bench.difference(&pair, &alone).unwrap();
        assert!(shared.len() > 150, "{}", shared.len());
        let (mut off, mut whole) = ([0.0; 6], [0.0; 6]);
        for (point, own) in &shared {
            let (own, other) = (numbers(own), numbers(&apart[point]));
            for k in 0..6 {
                off[k] += (own[k] - other[k]).powi(2);
                whole[k] += other[k].powi(2);
            }
        }
        for k in 0..6 {
            assert!(off[k] <= 0.05_f64.powi(2) * whole[k] + 1e-12 * shared.len() as f64, "{id} {k}: {off:?} of {whole:?}");
        }
    }
}

/// Of a Gaussian the formula of the page and the rendered column go alike: what differs is the size of a pixel beside the image.
#[test]
fn rendered_columns_go_with_the_formulas_of_their_pages() {
    let all = drawn(12, nothing);
    let stars = expected(&all);
    let columns = of_images(&stars, &stamps());
    let ids: Vec<&str> = columns.iter().map(|column| column.id).collect();
    assert_eq!(ids, ["nonlinearity", "brighter-fatter"]);
    for column in &columns {
        let effect = IMAGE_EFFECTS.iter().find(|effect| effect.id() == column.id).unwrap();
        let pairs = stars.iter().filter_map(|star| {
            let (own, formula) = (column.responses.get(&star.star.point)?, effect.responses(&star.star.image)?[0]);
            Some([own.second_px2[0], formula.second_px2[0]])
        });
        let (a, b, ab) = pairs.fold((0.0, 0.0, 0.0), |(a, b, ab), [x, y]| (a + x * x, b + y * y, ab + x * y));
        let cosine = ab / f64::sqrt(a * b);
        assert!(cosine > 0.98, "{}: {cosine}", column.id);
        let ratio = ab / b;
        assert!((0.6..1.6).contains(&ratio), "{}: {ratio}", column.id);
    }
}

/// The stars of which a column has a response, changed by so many units of it.
fn changed(stars: &[StarMeasurement], column: &RenderedColumn, units: f64) -> Vec<StarMeasurement> {
    let of = |star: &StarMeasurement| {
        let response = column.responses.get(&star.point)?;
        let mut own = *star;
        own.flux_dn *= 10.0_f64.powf(-0.4 * units * response.magnitude);
        if let Some(moments) = &mut own.moments {
            for k in 0..3 {
                moments.second_px2[k] += units * response.second_px2[k];
            }
            for k in 0..2 {
                moments.skewness[k] += units * response.skewness[k];
            }
        }
        Some(own)
    };
    stars.iter().filter_map(of).collect()
}

/// Stars changed by what is rendered are named after it, with its size, and nothing else is named. What changes all stars alike no star tells.
#[test]
fn what_is_rendered_is_found_in_light_and_shape() {
    let plain = drawn(13, nothing);
    let all = of_displacements(&expected(&plain), &stamps());
    let of = |id: &str, units: f64| {
        let column = all.iter().find(|column| column.id == id).unwrap_or_else(|| panic!("{id} is not rendered"));
        judge(&changed(&plain, column, units), None, FRAMES, &Asked { stamps: Some(stamps()), ..asked(1e-3) }, &[]).unwrap()
    };
    let (id, truth) = (<ChargeTransferInefficiency as CentroidShift>::ID, 0.1);
    let judged = of(id, truth);
    assert_eq!(found(&judged), [id], "{:?}", judged.proposed);
    let [value, sigma] = size(&judged, id).unwrap();
    assert!((value - truth).abs() < 4.0 * sigma + 0.1 * truth, "{id}: {value} ± {sigma}");
    assert!(judged.channels.values().all(|state| state.left_p_value > 1e-3), "{id}: {:?}", judged.channels);
    let judged = of(<Overshoot as CentroidShift>::ID, 0.03);
    assert!(found(&judged).is_empty(), "{:?}", judged.proposed);
}

/// Without a way to render them the columns are those of the formulas, and what has no formula is not asked.
#[test]
fn formulas_stand_where_nothing_is_rendered() {
    let plain = drawn(14, nothing);
    let ids = |rows: &Rows| rows.questions.iter().map(|question| question.id).collect::<Vec<_>>();
    let (by_formula, ..) = rows_of_stars(&plain, FRAMES, None);
    let (rendered, ..) = rows_of_stars(&plain, FRAMES, Some(&stamps()));
    assert!(!ids(&by_formula).contains(&"overshoot") && ids(&rendered).contains(&"overshoot"));
    let column = |rows: &Rows| {
        rows.questions.iter().find(|question| question.id == "nonlinearity").map(|question| question.columns[0].clone()).unwrap()
    };
    assert_ne!(column(&by_formula), column(&rendered));
}
