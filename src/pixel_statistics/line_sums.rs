//! Sums along straight lines of all places, slopes and lengths: the fast Radon transform.
//!
//! Strips of 2ᵏ rows have the sums along lines from every column of their first row to every column of their last one that is at most 45° away; two strips
//! make one of twice the height, with one addition a line. So an image of N pixels costs 2·N·log₂N additions, and every line is a digital one that is at most
//! half a pixel off in the mean. Source: W. A. Götz and H. J. Druckmüller, Pattern Recognition 29, 711 (1996); M. L. Brady, SIAM J. Comput. 27, 107 (1998);
//! for streaks: G. Nir, B. Zackay and E. O. Ofek, AJ 156, 229 (2018).

/// Deviations of pixels from the sky in units of its noise, row by row, and how many pixels each stands for: 1, or 0 where nothing is known.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: Vec<f32>,
    pub(super) counts: Vec<f32>,
}

/// A line across a strip: from the column `start` of its first row to the column `start + shift` of its last one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StripLine {
    pub(super) first_row: usize,
    pub(super) rows: usize,
    pub(super) start: usize,
    pub(super) shift: isize,
    /// Signal-to-noise ratio of a band of so many columns about it.
    pub(super) half_width: usize,
    pub(super) snr: f32,
}

impl Plane {
    /// With rows and columns exchanged.
    pub(super) fn transposed(&self) -> Self {
        let turned = |own: &[f32]| (0..own.len()).map(|k| own[k % self.height * self.width + k / self.height]).collect();
        Self { width: self.height, height: self.width, values: turned(&self.values), counts: turned(&self.counts) }
    }

    /// Calls `found` with every line of at least `least_rows` rows of which the band has more than `least_snr`, in units of the scatter of all bands of its
    /// length: noise of neighbours may go together.
    pub(super) fn lines_above(&self, least_rows: usize, half_widths: &[usize], least_snr: f32, mut found: impl FnMut(StripLine)) {
        let (mut rows, mut sums) = (1, self.values.clone());
        let mut counts = self.counts.clone();
        // The last strip is filled up with rows of which nothing is known.
        let strips = self.height.next_power_of_two();
        sums.resize(strips * self.width, 0.0);
        counts.resize(strips * self.width, 0.0);
        while rows < strips {
            sums = joined(&sums, rows, self.width);
            counts = joined(&counts, rows, self.width);
            rows *= 2;
            if rows >= least_rows {
                for half_width in half_widths {
                    self.scan((rows, *half_width), (&sums, &counts), least_snr, &mut found);
                }
            }
        }
    }

    fn scan(
        &self,
        (rows, half_width): (usize, usize),
        (sums, counts): (&[f32], &[f32]),
        least_snr: f32,
        found: &mut impl FnMut(StripLine),
    ) {
        /// Every so many-th line tells the scatter.
        const SAMPLE: usize = 61;
        /// A band of which less is known says nothing.
        const MIN_KNOWN: f32 = 0.5;
        const ROUNDING: f32 = 0.999;
        let (width, slopes) = (self.width, 2 * rows - 1);
        let band = 2 * half_width + 1;
        if width < band {
            return;
        }
        let least = MIN_KNOWN * (band * rows) as f32;
        let snr = |line: usize, start: usize| -> Option<f32> {
            let from = line * width + start - half_width;
            let known: f32 = counts[from..from + band].iter().sum();
            (known >= least).then(|| sums[from..from + band].iter().sum::<f32>() / known.sqrt())
        };
        let lines = sums.len() / width;
        let places = half_width..width - half_width;
        let all = lines * places.len();
        let sample: Vec<f64> =
            (0..all).step_by(SAMPLE).filter_map(|k| snr(k / places.len(), half_width + k % places.len())).map(f64::from).collect();
        let scatter = crate::statistics::mad_sigma(&sample).unwrap_or(1.0).max(1.0) as f32;
        // What cannot be enough by its square is not looked at further: roots are dear.
        let least_square = (ROUNDING * least_snr * scatter).powi(2);
        let (mut sum, mut known) = (vec![0.0; places.len()], vec![0.0; places.len()]);
        for line in 0..lines {
            for (band_sums, all) in [(&mut sum, sums), (&mut known, counts)] {
                add_bands(&all[line * width..][..width], band, band_sums);
            }
            if !is_any_enough(&sum, &known, least_square) {
                continue;
            }
            for (start, (sum, known)) in places.clone().zip(sum.iter().zip(&known)) {
                if !is_enough(*sum, *known, least_square) {
                    continue;
                }
                if let Some(snr) = snr(line, start).map(|snr| snr / scatter).filter(|snr| *snr > least_snr) {
                    let (strip, slope) = (line / slopes, line % slopes);
                    let shift = slope.cast_signed() - (rows - 1).cast_signed();
                    found(StripLine { first_row: strip * rows, rows, start, shift, half_width, snr });
                }
            }
        }
    }
}

/// The sum of every so many neighbours of a line.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn add_bands(line: &[f32], band: usize, sums: &mut [f32]) {
    sums.fill(0.0);
    for from in 0..band {
        sums.iter_mut().zip(&line[from..]).for_each(|(sum, value)| *sum += value);
    }
}

/// Whether a sum may be enough by its square.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into loops compiled for several instruction sets")]
fn is_enough(sum: f32, known: f32, least_square: f32) -> bool {
    // A place of which nothing is known has a sum of 0.
    sum > 0.0 && sum * sum >= least_square * known
}

/// The same for any of a line: most lines have none.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn is_any_enough(sums: &[f32], known: &[f32], least_square: f32) -> bool {
    sums.iter().zip(known).fold(false, |any, (sum, known)| any | is_enough(*sum, *known, least_square))
}

/// Strips of twice the height.
fn joined(of: &[f32], rows: usize, width: usize) -> Vec<f32> {
    let (slopes, twice) = (2 * rows - 1, 4 * rows - 1);
    let strips = of.len() / (slopes * width);
    let mut both = vec![0.0; strips / 2 * twice * width];
    for strip in 0..strips / 2 {
        let line = |strip: usize, shift: isize| {
            let slope = (shift + (rows - 1).cast_signed()).cast_unsigned();
            &of[(strip * slopes + slope) * width..][..width]
        };
        for slope in 0..twice {
            let shift = slope.cast_signed() - (2 * rows - 1).cast_signed();
            // Halved toward zero: what is left is the step between the strips.
            let half = shift / 2;
            let (upper, lower) = (line(2 * strip, half), line(2 * strip + 1, half));
            let target = &mut both[(strip * twice + slope) * width..][..width];
            target.copy_from_slice(upper);
            let on = shift - half;
            let (from, to) = if on >= 0 { (on.cast_unsigned(), 0) } else { (0, on.unsigned_abs()) };
            if from < width && to < width {
                for (sum, more) in target[to..].iter_mut().zip(&lower[from..]) {
                    *sum += more;
                }
            }
        }
    }
    both
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(width: usize, height: usize, lit: impl Fn(usize, usize) -> bool) -> Plane {
        let values = (0..width * height).map(|k| if lit(k % width, k / width) { 1.0 } else { 0.0 }).collect();
        Plane { width, height, values, counts: vec![1.0; width * height] }
    }

    /// A line of light has its sum along itself, and no other line has as much.
    #[test]
    fn a_line_has_its_own_sum() {
        for shift in [-31_isize, -17, 0, 5, 31] {
            let at = |y: usize| 40 + (shift as f64 * y as f64 / 31.0).round() as isize;
            let plane = plane(80, 32, |x, y| x.cast_signed() == at(y));
            let mut best: Option<StripLine> = None;
            plane.lines_above(32, &[0], 0.5, |line| {
                if best.is_none_or(|best| line.snr > best.snr) {
                    best = Some(line);
                }
            });
            let best = best.unwrap();
            // Digital lines of the same ends differ by a pixel here and there.
            assert!(best.snr > 0.7 * 32.0 / 32.0_f32.sqrt(), "{shift}: {best:?}");
            assert!((best.shift - shift).abs() <= 2 && best.start.abs_diff(40) <= 1, "{shift}: {best:?}");
        }
    }

    #[test]
    fn what_is_not_known_takes_no_part() {
        let mut half = plane(64, 32, |x, _| x == 20);
        for (k, count) in half.counts.iter_mut().enumerate() {
            if k / 64 < 20 {
                (*count, half.values[k]) = (0.0, 0.0);
            }
        }
        let mut found = 0;
        half.lines_above(32, &[0], 0.5, |_| found += 1);
        assert_eq!(found, 0, "less than half of every line is known");
        assert_eq!(half.transposed().transposed().values, half.values);
    }
}
