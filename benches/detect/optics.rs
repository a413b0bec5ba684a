//! The image of real optics (the renderer's, from wavefronts) learnt from its stars.

use boresight::detect::{Aids, Detections, detect_aided, learn};
use boresight::render::TrueStar;

use super::learnt::{Error, KEPT, beside_smooth};
use super::rendered::{Night, SIDE_PX, electrons, options};

/// What is drawn: a name and the scene's table.
const IMAGES: [(&str, &str); 3] = [
    (
        "defocus, coma, astigmatism",
        "[psf]\nkind = \"zernike\"\nreach_px = 12\nparameters = { lambda_n_px = 1.6, z4_waves = 0.06, z6_waves = 0.04, z7_waves = 0.07 }\n\
         pixel = { diffusion_px = 0.25 }\n",
    ),
    (
        "coma that grows outwards",
        "[psf]\nkind = \"zernike\"\nreach_px = 12\nfield_nodes = [9, 9]\nparameters = { lambda_n_px = 1.6 }\npixel = { diffusion_px = 0.25 }\n\
         vary = [{ parameter = \"z7_waves\", coefficient = 0.06, y = 1 }, { parameter = \"z8_waves\", coefficient = 0.06, x = 1 }]\n",
    ),
    (
        "curved field",
        "[psf]\nkind = \"zernike\"\nreach_px = 12\nfield_nodes = [9, 9]\nparameters = { lambda_n_px = 1.6, z4_waves = -0.05 }\n\
         pixel = { diffusion_px = 0.25 }\n\
         vary = [{ parameter = \"z4_waves\", coefficient = 0.1, x = 2 }, { parameter = \"z4_waves\", coefficient = 0.1, y = 2 }]\n",
    ),
];

/// Stars nearer to the edge of the frame are cut.
const EDGE_PX: f64 = 12.0;

fn errors(found: &Detections, stars: &[TrueStar]) -> Vec<Error> {
    let of = |star: &TrueStar| {
        let far = |d: &boresight::detect::Detection| (d.x_px - star.x_mean_px).hypot(d.y_px - star.y_mean_px);
        let d = found.stars.iter().min_by(|a, b| far(a).total_cmp(&far(b))).filter(|d| far(d) < 3.0)?;
        let stated_px2 = [d.covariance_px2[0], d.covariance_px2[2]];
        Some(Error {
            at_px: [star.x_mean_px, star.y_mean_px],
            aside_px: [d.x_px - star.x_mean_px, d.y_px - star.y_mean_px],
            stated_px2,
            bound_px2: stated_px2,
        })
    };
    // the truth's own mark of the edge tells light lost, and the wings of such images are cut
    let inside = |s: &&TrueStar| [s.x_mean_px, s.y_mean_px].iter().all(|at| (EDGE_PX..SIDE_PX as f64 - EDGE_PX).contains(at));
    stars.iter().filter(inside).filter_map(of).collect()
}

pub(crate) fn table(frames: usize, line: &mut impl FnMut(&str)) {
    line(
        "\nImages of optics, from wavefronts of the renderer: errors less a smooth field of order 5, px (2-D rms), and pull variance.\n\
         image                        SNR   stars   Gaussians: error, pull var   learnt: error, stated, pull var, order   χ²/dof held out; stars",
    );
    for (i, (name, psf)) in IMAGES.into_iter().enumerate() {
        for (k, snr) in [30.0, 100.0, 300.0].into_iter().enumerate() {
            let light = electrons(snr);
            let night = Night::new([0.0; 2], frames, 700 + (10 * i + k) as u64, |_| vec![([0.0; 2], light)]).with_image(psf);
            let look = |aids: &Aids<'_>| {
                night.frames(|frame, stars| {
                    let (found, kept) = detect_aided(frame, &options(), aids).expect("a frame that can be measured");
                    (errors(&found, &stars), kept)
                })
            };
            let (gaussian, kept): (Vec<_>, Vec<_>) = look(&Aids { keep: KEPT, ..Aids::default() }).into_iter().unzip();
            let gaussian = gaussian.concat();
            let rms = |errors: &[Error]| {
                let stated = (errors.iter().map(|e| e.stated_px2[0] + e.stated_px2[1]).sum::<f64>() / errors.len() as f64).sqrt();
                let (ratio, pull2) = beside_smooth(errors, SIDE_PX);
                (ratio * stated, stated, pull2)
            };
            let (error, _, pull2) = rms(&gaussian);
            let (psf, report) = learn(&kept.concat());
            let own = psf.as_ref().map_or_else(
                || "Gaussians stay".to_owned(),
                |psf| {
                    let own = look(&Aids { psf: Some(psf), ..Aids::default() });
                    let (error, stated, pull2) = rms(&own.into_iter().flat_map(|o| o.0).collect::<Vec<_>>());
                    format!("{error:.5} {stated:.5} {pull2:7.4} {}", report.field_order)
                },
            );
            line(&format!(
                "{name:28} {snr:4.0}  {:6}    {error:.5} {pull2:9.4}    {own}    {:.3} {:.3} {}",
                gaussian.len(),
                report.gaussian_deviance_per_dof,
                report.empirical_deviance_per_dof,
                report.stars
            ));
        }
    }
}
