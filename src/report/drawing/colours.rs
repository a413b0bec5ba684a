//! Colours for numbers: a map from pale to deep, and the ticks of its bar.

use plotters::style::RGBColor;

use super::canvas::{short, tick_step};

/// From pale yellow over green to blue (YlGnBu of ColorBrewer without its darkest part): lightness falls all the way, so that people with any
/// colour vision, and a grey print, have the same order; and dark dots and lines stay visible on all of it.
const COLOURS: [[f64; 3]; 6] = [
    [255.0, 255.0, 217.0],
    [237.0, 248.0, 177.0],
    [199.0, 233.0, 180.0],
    [127.0, 205.0, 187.0],
    [65.0, 182.0, 196.0],
    [45.0, 145.0, 196.0],
];

/// The largest value over the smallest above which a linear scale would show its upper end alone.
const WIDE: f64 = 30.0;

/// The colour at a share of the scale, 0 to 1.
pub(super) fn colour(share: f64) -> RGBColor {
    let steps = COLOURS.len() - 1;
    let place = share.clamp(0.0, 1.0) * steps as f64;
    let below = (place.floor() as usize).min(steps - 1);
    let part = place - below as f64;
    let [red, green, blue] =
        std::array::from_fn(|k| (COLOURS[below][k] + part * (COLOURS[below + 1][k] - COLOURS[below][k])).round() as u8);
    RGBColor(red, green, blue)
}

/// From values to shares of the colour scale.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scale {
    low: f64,
    high: f64,
    logarithmic: bool,
    /// Values with a tick and a contour; the ends are among them where they are round.
    pub(super) ticks: Vec<f64>,
}

impl Scale {
    /// A scale with round ends that holds these values. Values that are not finite do not count.
    pub(super) fn holding(values: &[f64]) -> Self {
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        if low > 0.0 && high > WIDE * low {
            let least = 10_f64.powf(low.log10().floor());
            let ticks = (0..300).map(|k| [1.0, 2.0, 5.0][k % 3] * least * 10_f64.powf((k / 3) as f64));
            let inside = ticks.filter(|tick| *tick >= low * (1.0 - 1e-9)).take_while(|tick| *tick <= high * (1.0 + 1e-9)).collect();
            return Self { low, high, logarithmic: true, ticks: inside };
        }
        // A flat map is drawn pale and not as the noise of its rounding.
        let span = if high - low > 1e-6 * high.abs() { high - low } else { high.abs().max(1.0) };
        let step = tick_step(span, 7.0);
        let (first, last) = ((low / step + 1e-9).floor(), ((low + span) / step - 1e-9).ceil());
        let ticks = (0..=(last - first) as usize).map(|k| (first + k as f64) * step).collect();
        Self { low: first * step, high: last * step, logarithmic: false, ticks }
    }

    /// Where on the scale a value lies, 0 to 1.
    pub(super) fn share(&self, value: f64) -> f64 {
        if self.logarithmic { (value / self.low).ln() / (self.high / self.low).ln() } else { (value - self.low) / (self.high - self.low) }
    }

    /// The same scale with other units: each value times a factor, with round ticks of its own inside the same ends.
    pub(super) fn times(&self, factor: f64) -> Self {
        let (low, high) = (self.low * factor, self.high * factor);
        let own = Self::holding(&[low, high]);
        let inside = |tick: &f64| *tick >= low - 1e-9 * high.abs() && *tick <= high * (1.0 + 1e-9);
        Self { low, high, logarithmic: self.logarithmic, ticks: own.ticks.into_iter().filter(inside).collect() }
    }

    /// A tick's number with as many digits as its neighbours need.
    pub(super) fn label(&self, tick: f64) -> String {
        let step = self.ticks.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
        if self.logarithmic || !step.is_finite() || step < 1e-6 || tick.abs() >= 1e5 {
            return short(tick);
        }
        let digits = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
        format!("{:.digits$}", if tick.abs() < step * 1e-6 { 0.0 } else { tick }).replace('-', "−")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_falls_all_the_way() {
        let lightness = |share: f64| {
            let RGBColor(red, green, blue) = colour(share);
            0.2126 * f64::from(red) + 0.7152 * f64::from(green) + 0.0722 * f64::from(blue)
        };
        for step in 0..50 {
            assert!(lightness(f64::from(step) / 50.0) > lightness(f64::from(step + 1) / 50.0), "{step}");
        }
        assert_eq!((colour(-1.0), colour(2.0)), (colour(0.0), colour(1.0)));
    }

    #[test]
    fn scales_hold_their_values_with_round_ticks() {
        let scale = Scale::holding(&[0.0047, f64::NAN, 0.0213]);
        assert!(scale.share(0.0047) >= 0.0 && scale.share(0.0213) <= 1.0 && !scale.logarithmic);
        let labels: Vec<String> = scale.ticks.iter().map(|tick| scale.label(*tick)).collect();
        assert_eq!(labels, ["0.000", "0.005", "0.010", "0.015", "0.020", "0.025"]);
        let arcsec = scale.times(40.0);
        assert_eq!(arcsec.ticks.iter().map(|tick| arcsec.label(*tick)).collect::<Vec<_>>(), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert!((arcsec.share(0.4) - scale.share(0.01)).abs() < 1e-12, "the same place");
        let wide = Scale::holding(&[0.003, 0.9]);
        assert!(wide.logarithmic && wide.ticks.first() == Some(&0.005) && wide.share(0.9) > 0.999);
        for flat in [[0.0, 0.0], [3.0, 3.0]] {
            let scale = Scale::holding(&flat);
            assert!(scale.ticks.len() > 2 && (0.0..=1.0).contains(&scale.share(flat[0])), "{scale:?}");
        }
    }
}
