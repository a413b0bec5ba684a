//! The sample of a metric, from scored frames, cameras and nights.

use std::collections::BTreeMap;

use super::answers::AnswerStatus;
use super::components::{Stratum, pooled, strata};
use super::metric::{Metric, Quantity, Statistic};
use super::own::NightAnswer;
use super::sample::{MetricSample, Unit};
use super::score::{AttitudeError, CameraScore, ScoredFrame, SeenStar};
use crate::units::ARCSEC_RAD;

/// Stars of this signal-to-noise ratio and more are held to be seen, where a metric does not say another.
const SEEN_SNR: f64 = 10.0;

/// All that was scored at a value of a sweep.
#[derive(Debug, Default)]
pub(super) struct CaseScores {
    pub(super) frames: Vec<ScoredFrame>,
    pub(super) cameras: Vec<CameraScore>,
    pub(super) nights: Vec<NightAnswer>,
    /// What a diagnosis is to name.
    pub(super) hidden: Vec<String>,
}

impl CaseScores {
    /// The sample of a metric; `None`: the answers hold nothing of it.
    pub(super) fn sample(&self, metric: &Metric) -> Option<MetricSample> {
        let frames = &self.frames;
        let share = |is_hit: &dyn Fn(&ScoredFrame) -> bool| {
            let hits = frames.iter().filter(|frame| is_hit(frame)).count() as u64;
            Some(MetricSample::Share { hits, trials: frames.len() as u64 })
        };
        // Of what the sky shows, frames of a field or of a sequence share a part.
        let share_of_sky = |is_hit: &dyn Fn(&ScoredFrame) -> bool| {
            let unit = |frame| (frame, Unit { sum: f64::from(u8::from(is_hit(frame))), count: 1.0 });
            if self.is_clustered() { Some(MetricSample::ClusteredShare(by_unit(frames.iter().map(unit)))) } else { share(is_hit) }
        };
        match metric.quantity {
            Quantity::Correct => share_of_sky(&|frame| frame.is_right),
            Quantity::False => share_of_sky(&|frame| frame.status == AnswerStatus::Solved && !frame.is_right),
            Quantity::None => share_of_sky(&|frame| frame.status != AnswerStatus::Solved),
            Quantity::Crashes => share(&|frame| frame.status == AnswerStatus::Crashed),
            Quantity::TimeOuts => share(&|frame| frame.status == AnswerStatus::TimedOut),
            Quantity::FirstFrames => alone(self.first_frames(), metric.statistic),
            Quantity::AgainFrames => alone(self.again_frames(), metric.statistic),
            Quantity::CrossBoresight => self.attitude(metric.statistic, &|error| error.boresight_rad.to_vec(), &|error| error.cross_rad),
            Quantity::AboutBoresight => self.attitude(metric.statistic, &|error| vec![error.about_rad], &|error| error.about_rad.abs()),
            Quantity::Latency => alone(frames.iter().filter_map(|frame| frame.latency_s).collect(), metric.statistic),
            Quantity::Memory => alone(frames.iter().filter_map(|frame| frame.peak_mib).collect(), metric.statistic),
            Quantity::FocalLength | Quantity::Pulls | Quantity::MapError => self.camera(metric),
            Quantity::RightDiagnosis | Quantity::FalseDiagnosis => self.diagnosis(metric.quantity),
            _ => self.stars(metric),
        }
    }

    /// Whether frames share parts of their errors: then these units are independent, and not their frames.
    fn is_clustered(&self) -> bool {
        self.frames.windows(2).any(|pair| pair[0].place.unit == pair[1].place.unit)
    }

    fn errors(&self) -> impl Iterator<Item = (&ScoredFrame, AttitudeError)> {
        self.frames.iter().filter(|frame| frame.is_right).filter_map(|frame| Some((frame, frame.error?)))
    }

    /// Samples of attitude errors in arcsec, of right answers: `axes` gives the components, `size` the whole.
    fn attitude(
        &self,
        statistic: Statistic,
        axes: &dyn Fn(&AttitudeError) -> Vec<f64>,
        size: &dyn Fn(&AttitudeError) -> f64,
    ) -> Option<MetricSample> {
        let components: Vec<Vec<f64>> =
            self.errors().map(|(_, error)| axes(&error).into_iter().map(|own| own / ARCSEC_RAD).collect()).collect();
        let count = components.first()?.len();
        match statistic {
            Statistic::Rms => {
                let unit = |own: &Vec<f64>| Unit { sum: own.iter().map(|own| own * own).sum(), count: count as f64 };
                let units = by_unit(self.errors().map(|(frame, _)| frame).zip(components.iter().map(unit)));
                Some(MetricSample::RootMeanSquare { units, factor: count as f64 })
            }
            Statistic::Bias => {
                let means = |axis| unit_means(self.errors().map(|(frame, _)| frame).zip(components.iter().map(|own| own[axis])));
                Some(MetricSample::Bias((0..count).map(means).collect()))
            }
            Statistic::TemporalNoise => self.component(axes, count, 0),
            Statistic::PixelSpatial => self.component(axes, count, 1),
            Statistic::FovSpatial => self.component(axes, count, 2),
            other => sizes(self.errors().map(|(frame, error)| (frame, size(&error) / ARCSEC_RAD)).collect(), other),
        }
    }

    /// A component of variance, both axes together where there are two.
    fn component(&self, axes: &dyn Fn(&AttitudeError) -> Vec<f64>, count: usize, level: usize) -> Option<MetricSample> {
        let mut all: BTreeMap<usize, BTreeMap<usize, Vec<Vec<f64>>>> = BTreeMap::new();
        for (frame, error) in self.errors() {
            let own = axes(&error).into_iter().map(|own| own / ARCSEC_RAD).collect();
            all.entry(frame.place.field).or_default().entry(frame.place.place).or_default().push(own);
        }
        // What lacks an answer leaves its field out: the design is to be balanced.
        let places = all.values().map(BTreeMap::len).max()?;
        let repeats = most_common(all.values().flat_map(BTreeMap::values).map(Vec::len))?;
        let whole = |field: &BTreeMap<usize, Vec<Vec<f64>>>| field.len() == places && field.values().all(|place| place.len() >= repeats);
        let kept: Vec<_> = all.into_values().filter(whole).collect();
        let axis = |axis: usize| -> Vec<Vec<Vec<f64>>> {
            let of_place = |place: &Vec<Vec<f64>>| place.iter().take(repeats).map(|own| own[axis]).collect();
            kept.iter().map(|field| field.values().map(of_place).collect()).collect()
        };
        let first = strata(&axis(0));
        let both: [Option<Stratum>; 3] = if count == 2 {
            let second = strata(&axis(1));
            [0, 1, 2].map(|level| pooled(first[level], second[level]))
        } else {
            first
        };
        let upto: Option<Vec<Stratum>> = both[..=level].iter().copied().collect();
        Some(MetricSample::Component { strata: upto?, level })
    }

    /// Frames until the first right answer of each whole sequence; of one without any, one more than it has.
    fn first_frames(&self) -> Vec<f64> {
        self.sequences().map(|frames| frames.iter().position(|frame| frame.is_right).map_or(frames.len() + 1, |at| at + 1) as f64).collect()
    }

    /// Frames from the first without a right answer, after there had been one, to the next right one.
    fn again_frames(&self) -> Vec<f64> {
        let mut all = Vec::new();
        for frames in self.sequences() {
            let mut lost: Option<usize> = None;
            let first = frames.iter().position(|frame| frame.is_right).unwrap_or(frames.len());
            for (at, frame) in frames.iter().enumerate().skip(first) {
                match (frame.is_right, lost) {
                    (false, None) => lost = Some(at),
                    (true, Some(since)) => {
                        all.push((at - since) as f64);
                        lost = None;
                    }
                    _ => {}
                }
            }
        }
        all
    }

    fn sequences(&self) -> impl Iterator<Item = &[ScoredFrame]> {
        self.frames.chunk_by(|a, b| a.place.sequence == b.place.sequence)
    }

    fn stars(&self, metric: &Metric) -> Option<MetricSample> {
        let snr = if let Statistic::Snr(snr) = metric.statistic { snr } else { SEEN_SNR };
        let told: Vec<(&ScoredFrame, &Vec<SeenStar>)> =
            self.frames.iter().filter_map(|frame| Some((frame, frame.stars.as_ref()?))).collect();
        if told.is_empty() {
            return None;
        }
        let share = |is_hit: &dyn Fn(&SeenStar) -> bool| {
            let unit = |(_, stars): &(&ScoredFrame, &Vec<SeenStar>)| {
                let seen = stars.iter().filter(|star| star.snr >= snr && star.is_clean);
                let (mut sum, mut count) = (0.0, 0.0);
                for star in seen {
                    count += 1.0;
                    sum += f64::from(u8::from(is_hit(star)));
                }
                Unit { sum, count }
            };
            Some(MetricSample::ClusteredShare(by_unit(told.iter().map(|own| (own.0, unit(own))))))
        };
        match metric.quantity {
            Quantity::Completeness => share(&|star| star.error_px.is_some()),
            Quantity::RightNames => share(&|star| star.is_named),
            Quantity::MissedNames => share(&|star| !star.is_named),
            Quantity::WrongNames => {
                let unit = |frame: &ScoredFrame| Unit { sum: frame.misnamed as f64, count: frame.named as f64 };
                let units = by_unit(told.iter().map(|(frame, _)| (*frame, unit(frame))));
                units.iter().any(|unit| unit.count > 0.0).then_some(MetricSample::ClusteredShare(units))
            }
            Quantity::FalseStars => Some(MetricSample::Mean(unit_means(told.iter().map(|(frame, _)| (*frame, frame.false_stars as f64))))),
            Quantity::SCurve => Some(MetricSample::Bias(s_curve(&told))),
            _ => centroid_errors(&told, metric.statistic),
        }
    }

    fn camera(&self, metric: &Metric) -> Option<MetricSample> {
        let cameras = &self.cameras;
        match metric.quantity {
            Quantity::FocalLength => {
                let values: Vec<f64> = cameras.iter().filter_map(|camera| camera.focal_length_relative).collect();
                match metric.statistic {
                    Statistic::Bias => some_of(MetricSample::Bias(vec![values])),
                    Statistic::Rms => some_of(MetricSample::RootMeanSquare {
                        units: values.iter().map(|own| Unit { sum: own * own, count: 1.0 }).collect(),
                        factor: 1.0,
                    }),
                    other => alone(values.iter().map(|own| own.abs()).collect(), other),
                }
            }
            Quantity::Pulls => {
                let unit =
                    |camera: &CameraScore| Unit { sum: camera.pulls.iter().map(|own| own * own).sum(), count: camera.pulls.len() as f64 };
                match metric.statistic {
                    Statistic::Bias => {
                        some_of(MetricSample::Bias(vec![cameras.iter().filter_map(|camera| camera.pulls.first().copied()).collect()]))
                    }
                    _ => some_of(MetricSample::RootMeanSquare { units: cameras.iter().map(unit).collect(), factor: 1.0 }),
                }
            }
            _ => alone(cameras.iter().filter_map(|camera| camera.map_px).collect(), metric.statistic),
        }
    }

    fn diagnosis(&self, quantity: Quantity) -> Option<MetricSample> {
        if self.nights.is_empty() {
            return None;
        }
        let named = |night: &NightAnswer, id: &String| night.named.as_ref().is_some_and(|named| named.contains(id));
        let is_hit = |night: &&NightAnswer| match quantity {
            Quantity::RightDiagnosis => self.hidden.iter().all(|id| named(night, id)),
            _ => night.named.iter().flatten().any(|id| !self.hidden.contains(id)),
        };
        Some(MetricSample::Share { hits: self.nights.iter().filter(is_hit).count() as u64, trials: self.nights.len() as u64 })
    }
}

fn some_of(sample: MetricSample) -> Option<MetricSample> {
    (sample.units() > 0).then_some(sample)
}

fn most_common(counts: impl Iterator<Item = usize>) -> Option<usize> {
    let mut all: BTreeMap<usize, usize> = BTreeMap::new();
    for count in counts {
        *all.entry(count).or_default() += 1;
    }
    all.into_iter().max_by_key(|(count, often)| (*often, *count)).map(|(count, _)| count)
}

/// Mean, quantile or largest of values that share nothing.
fn alone(values: Vec<f64>, statistic: Statistic) -> Option<MetricSample> {
    if values.is_empty() {
        return None;
    }
    Some(match statistic {
        Statistic::Quantile(share) => MetricSample::Quantile { units: (0..values.len()).collect(), values, share },
        Statistic::Max => MetricSample::Largest(values),
        _ => MetricSample::Mean(values),
    })
}

/// The same of one value a frame.
fn sizes(told: Vec<(&ScoredFrame, f64)>, statistic: Statistic) -> Option<MetricSample> {
    let of_units = |(frame, value): (&ScoredFrame, f64)| (frame.place.unit, value);
    match statistic {
        Statistic::Quantile(share) if !told.is_empty() => {
            let (units, values) = told.into_iter().map(of_units).unzip();
            Some(MetricSample::Quantile { units, values, share })
        }
        Statistic::Max => alone(told.into_iter().map(|(_, value)| value).collect(), statistic),
        _ => alone(unit_means(told.into_iter()), statistic),
    }
}

/// Sums over the frames of each independent unit.
fn by_unit<'a>(of_frames: impl Iterator<Item = (&'a ScoredFrame, Unit)>) -> Vec<Unit> {
    let mut sums: BTreeMap<usize, Unit> = BTreeMap::new();
    for (frame, own) in of_frames {
        let sum = sums.entry(frame.place.unit).or_insert(Unit { sum: 0.0, count: 0.0 });
        (sum.sum, sum.count) = (sum.sum + own.sum, sum.count + own.count);
    }
    sums.into_values().collect()
}

/// Means over the frames of each independent unit.
fn unit_means<'a>(of_frames: impl Iterator<Item = (&'a ScoredFrame, f64)>) -> Vec<f64> {
    by_unit(of_frames.map(|(frame, sum)| (frame, Unit { sum, count: 1.0 }))).into_iter().map(|unit| unit.sum / unit.count).collect()
}

/// Errors of the centroids of clean stars.
fn centroid_errors(told: &[(&ScoredFrame, &Vec<SeenStar>)], statistic: Statistic) -> Option<MetricSample> {
    let of_frame = |stars: &Vec<SeenStar>| -> Vec<[f64; 2]> {
        stars.iter().filter(|star| star.is_clean && star.snr >= SEEN_SNR).filter_map(|star| star.error_px).collect()
    };
    let all: Vec<(&ScoredFrame, Vec<[f64; 2]>)> =
        told.iter().map(|(frame, stars)| (*frame, of_frame(stars))).filter(|(_, errors)| !errors.is_empty()).collect();
    if statistic == Statistic::Bias {
        let mean = |errors: &Vec<[f64; 2]>, axis: usize| errors.iter().map(|error| error[axis]).sum::<f64>() / errors.len() as f64;
        let means = |axis| unit_means(all.iter().map(|(frame, errors)| (*frame, mean(errors, axis))));
        return some_of(MetricSample::Bias((0..2).map(means).collect()));
    }
    let unit = |errors: &Vec<[f64; 2]>| Unit { sum: errors.iter().flatten().map(|own| own * own).sum(), count: 2.0 * errors.len() as f64 };
    some_of(MetricSample::RootMeanSquare { units: by_unit(all.iter().map(|(frame, errors)| (*frame, unit(errors)))), factor: 2.0 })
}

/// The S-curve of both axes: twice the mean product of the error with sine and cosine of the place within the pixel, frame by frame.
fn s_curve(told: &[(&ScoredFrame, &Vec<SeenStar>)]) -> Vec<Vec<f64>> {
    let of_frame = |stars: &Vec<SeenStar>| {
        let (mut sums, mut count) = ([0.0; 2], 0.0);
        for star in stars.iter().filter(|star| star.is_clean && star.snr >= SEEN_SNR) {
            for axis in 0..2 {
                if let Some(error) = star.error_px {
                    let (sin, cos) = (std::f64::consts::TAU * star.place_px[axis]).sin_cos();
                    sums = [sums[0] + error[axis] * sin, sums[1] + error[axis] * cos];
                    count += 1.0;
                }
            }
        }
        (count > 0.0).then(|| sums.map(|sum| 2.0 * sum / count))
    };
    let all: Vec<(&ScoredFrame, [f64; 2])> = told.iter().filter_map(|(frame, stars)| Some((*frame, of_frame(stars)?))).collect();
    (0..2).map(|part| unit_means(all.iter().map(|(frame, own)| (*frame, own[part])))).collect()
}
