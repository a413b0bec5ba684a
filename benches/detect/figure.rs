//! Error of the centroid against brightness: the bound, maximum likelihood, windowed moments.

use std::path::Path;

use boresight::report::Lettered;
use plotters::prelude::*;

use crate::study::magnitude;

/// Columns and rows of the picture.
const SIZE_PX: (u32, u32) = (1200, 520);

type Failed = Box<dyn std::error::Error>;

/// Draws a panel for the narrowest images and one for the widest.
pub(crate) fn draw(file: &Path, curve: &[[f64; 5]]) -> Result<(), Failed> {
    let mut pixels = vec![0; SIZE_PX.0 as usize * SIZE_PX.1 as usize * 3];
    draw_into(&mut pixels, curve)?;
    let image = image::RgbImage::from_raw(SIZE_PX.0, SIZE_PX.1, pixels).ok_or("the buffer has the size of the picture")?;
    Ok(image.save(file)?)
}

fn draw_into(pixels: &mut [u8], curve: &[[f64; 5]]) -> Result<(), Failed> {
    let area = Lettered::new(BitMapBackend::with_buffer(pixels, SIZE_PX)).into_drawing_area();
    area.fill(&WHITE).map_err(|error| error.to_string())?;
    let widths: Vec<f64> = [curve.first(), curve.last()].into_iter().flatten().map(|point| point[0]).collect();
    for (panel, sigma) in area.split_evenly((1, 2)).iter().zip(widths) {
        let points: Vec<&[f64; 5]> = curve.iter().filter(|point| point[0] == sigma).collect();
        let magnitudes: Vec<f64> = points.iter().map(|point| magnitude(point[1])).collect();
        let (bright, faint) = (magnitudes.iter().copied().fold(f64::MAX, f64::min), magnitudes.iter().copied().fold(f64::MIN, f64::max));
        let mut chart = ChartBuilder::on(panel)
            .caption(format!("images of σ {sigma} px"), ("sans-serif", 22))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(64)
            .build_cartesian_2d(bright - 0.3..faint + 0.3, (3e-4..1.0).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("V (zero point 25 mag at 1 e)")
            .y_desc("2-D rms error / px")
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .draw()?;
        for (column, name, colour) in [(4, "windowed", RED), (2, "Cramér–Rao bound", BLACK), (3, "maximum likelihood", BLUE)] {
            let line: Vec<(f64, f64)> = magnitudes.iter().zip(&points).map(|(v, point)| (*v, point[column])).collect();
            if column == 2 {
                chart.draw_series([PathElement::new(line.clone(), colour.stroke_width(2))])?
            } else {
                chart.draw_series(line.iter().map(|at| Circle::new(*at, 5, colour.filled())))?
            }
            .label(name)
            .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .border_style(BLACK.mix(0.3))
            .background_style(WHITE)
            .label_font(("sans-serif", 16))
            .draw()?;
    }
    area.present()?;
    Ok(())
}
