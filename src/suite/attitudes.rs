//! Where the camera points in each frame of a case, and which place of the design a frame has.
//!
//! The attitude of a frame follows from the seed, the case and the frame's number alone, so that frames can be added, made alone, and are the same for every
//! value of a sweep.

use super::suite_file::{AttitudeKind, AttitudeTable};
use crate::coordinates::{Attitude, Direction, Icrs};
use crate::dataset::AddressedChance;
use crate::dual::dot;

/// The place of a frame in its design.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct DesignPlace {
    /// Which attitude at large.
    pub field: usize,
    /// Which place within a pixel.
    pub place: usize,
    /// Which exposure of it.
    pub repeat: usize,
    /// Which sequence of frames.
    pub sequence: usize,
    /// Which independent unit: frames of one field, or of one sequence, share a part of their errors.
    pub unit: usize,
}

impl DesignPlace {
    /// Of a frame that shares nothing with the others.
    pub(super) fn alone(index: usize) -> Self {
        Self { field: index, unit: index, ..Self::default() }
    }
}

/// The attitudes of a case.
#[derive(Clone, Debug)]
pub(super) struct AttitudePlan {
    pub(super) table: AttitudeTable,
    pub(super) list: Vec<Attitude>,
    chance: AddressedChance,
    focal_length_px: f64,
}

/// The level of chance that attitudes are drawn on.
const LEVEL: u32 = 0x5355;

impl AttitudePlan {
    pub(super) fn new(seed: u64, case: &str, table: AttitudeTable, list: Vec<Attitude>, focal_length_px: f64) -> Self {
        Self { table, list, chance: AddressedChance::new(seed, LEVEL, case), focal_length_px }
    }

    /// The attitude of a frame and its place; `zenith` in ICRS axes is that of its time, where attitudes must keep above the horizon.
    pub(super) fn frame(&self, index: usize, zenith: Option<[f64; 3]>) -> (Attitude, DesignPlace) {
        let table = &self.table;
        let alone = DesignPlace::alone(index);
        match table.kind {
            AttitudeKind::Uniform | AttitudeKind::Scene => (self.drawn(index, zenith), alone),
            AttitudeKind::List => (self.list[index % self.list.len()], alone),
            AttitudeKind::Stare => (self.fixed(0, zenith), DesignPlace { field: 0, repeat: index, ..alone }),
            AttitudeKind::Dither => {
                let places = table.grid * table.grid;
                let (place, repeat) = (index % places, index / places);
                (self.within_pixel(&self.fixed(0, zenith), place), DesignPlace { field: 0, place, repeat, sequence: 0, unit: index })
            }
            AttitudeKind::Nested => {
                let places = table.grid * table.grid;
                let (field, rest) = (index / (places * table.repeats), index % (places * table.repeats));
                let (place, repeat) = (rest / table.repeats, rest % table.repeats);
                (self.within_pixel(&self.drawn(field, zenith), place), DesignPlace { field, place, repeat, sequence: 0, unit: field })
            }
            AttitudeKind::Scan => {
                let (sequence, step) = (index / table.sequence, index % table.sequence);
                let start = if sequence == 0 { self.fixed(0, zenith) } else { self.drawn(sequence, zenith) };
                let by_rad = step as f64 * table.step_px / self.focal_length_px;
                // Neither along rows nor along columns, so that both axes see the whole field and every place within a pixel.
                let (sin, cos) = 0.61_f64.sin_cos();
                (start.turned([by_rad * sin, by_rad * cos, 0.0]), DesignPlace { sequence, unit: sequence, ..alone })
            }
        }
    }

    /// The seed of the noise of the case's frames.
    pub(super) fn noise_seed(&self) -> i64 {
        let [low, high, ..] = self.chance.words(u64::MAX, 0);
        // Whole numbers of TOML have 63 bits.
        (i64::from(high) << 32 | i64::from(low)) & i64::MAX
    }

    /// How many frames share a part of their errors: those of a field or of a sequence. Of a dither or a stare the places are the design's own.
    pub(super) fn frames_per_unit(&self) -> usize {
        if matches!(self.table.kind, AttitudeKind::Nested | AttitudeKind::Scan) { self.frames_per_field() } else { 1 }
    }

    /// How many frames make one whole field of the design.
    pub(super) fn frames_per_field(&self) -> usize {
        match self.table.kind {
            AttitudeKind::Nested => self.table.grid * self.table.grid * self.table.repeats,
            AttitudeKind::Dither => self.table.grid * self.table.grid,
            AttitudeKind::Scan => self.table.sequence,
            _ => 1,
        }
    }

    fn fixed(&self, index: usize, zenith: Option<[f64; 3]>) -> Attitude {
        match self.table.at_deg {
            Some(at_deg) => {
                let [ra, dec, roll] = at_deg.map(f64::to_radians);
                Attitude::from_pointing(ra, dec, roll)
            }
            None => self.drawn(index, zenith),
        }
    }

    /// By chance, evenly over the sphere; above the lowest altitude where there is a zenith.
    fn drawn(&self, index: usize, zenith: Option<[f64; 3]>) -> Attitude {
        const TRIES: u32 = 10_000;
        let lowest = self.table.lowest_altitude_deg.to_radians().sin();
        let unit = |number| self.chance.uniform(index as u64, number);
        let pointing = |round: u32| {
            let ra = std::f64::consts::TAU * unit(3 * round);
            let dec = (2.0 * unit(3 * round + 1) - 1.0).clamp(-1.0, 1.0).asin();
            (ra, dec, std::f64::consts::TAU * unit(3 * round + 2))
        };
        let is_up = |(ra, dec, _): &(f64, f64, f64)| {
            zenith.is_none_or(|zenith| dot(Direction::<Icrs>::from_radec_rad(*ra, *dec).xyz, zenith) >= lowest)
        };
        let (ra, dec, roll) = (0..TRIES).map(pointing).find(is_up).unwrap_or_else(|| pointing(0));
        Attitude::from_pointing(ra, dec, roll)
    }

    /// The attitude turned so that stars move by a part of a pixel.
    fn within_pixel(&self, attitude: &Attitude, place: usize) -> Attitude {
        let grid = self.table.grid;
        let part = |number: usize| number as f64 / grid as f64 / self.focal_length_px;
        attitude.turned([part(place / grid), part(place % grid), 0.0])
    }
}

/// Reads a list of attitudes: `ra_deg,dec_deg,roll_deg`.
pub(super) fn read_list(text: &str) -> Result<Vec<Attitude>, String> {
    #[derive(serde::Deserialize)]
    #[allow(clippy::struct_field_names, reason = "the columns of the file")]
    struct Row {
        ra_deg: f64,
        dec_deg: f64,
        roll_deg: f64,
    }
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let rows = reader.deserialize::<Row>().map(|row| {
        let Row { ra_deg, dec_deg, roll_deg } = row.map_err(|error| error.to_string().replace('\n', " "))?;
        Ok(Attitude::from_pointing(ra_deg.to_radians(), dec_deg.to_radians(), roll_deg.to_radians()))
    });
    let all = rows.collect::<Result<Vec<_>, String>>()?;
    if all.is_empty() { Err("holds no attitude; write ra_deg,dec_deg,roll_deg and a line for each".to_owned()) } else { Ok(all) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(kind: AttitudeKind) -> AttitudePlan {
        AttitudePlan::new(1, "a case", AttitudeTable { kind, ..AttitudeTable::default() }, Vec::new(), 1000.0)
    }

    fn boresight(attitude: &Attitude) -> [f64; 3] {
        attitude.rows()[2]
    }

    #[test]
    fn uniform_attitudes_cover_the_sphere_evenly() {
        let plan = plan(AttitudeKind::Uniform);
        let sums =
            (0..4000).map(|index| boresight(&plan.frame(index, None).0)).fold([0.0; 3], |sums, xyz| [0, 1, 2].map(|k| sums[k] + xyz[k]));
        assert!(sums.iter().all(|sum| sum.abs() / 4000.0 < 0.03), "{sums:?}");
        let up = [0.0, 0.6, 0.8];
        let lowest = plan.table.lowest_altitude_deg.to_radians().sin();
        assert!((0..300).all(|index| dot(boresight(&plan.frame(index, Some(up)).0), up) >= lowest));
        assert!((0..300).any(|index| dot(boresight(&plan.frame(index, None).0), up) < lowest));
    }

    #[test]
    fn designs_hold_places_and_repeats() {
        let nested = plan(AttitudeKind::Nested);
        let all: Vec<(Attitude, DesignPlace)> = (0..54).map(|index| nested.frame(index, None)).collect();
        assert_eq!((nested.frames_per_field(), all[53].1), (27, DesignPlace { field: 1, place: 8, repeat: 2, sequence: 0, unit: 1 }));
        assert_eq!(all[0].0, all[2].0);
        let apart = all[0].0.camera_from_icrs.angle_to(&all[3].0.camera_from_icrs);
        assert!((apart - 1.0 / 3.0 / 1000.0).abs() < 1e-9, "{apart}");
        let stare = plan(AttitudeKind::Stare);
        assert_eq!(stare.frame(0, None).0, stare.frame(99, None).0);
        let scan = plan(AttitudeKind::Scan);
        let step = scan.frame(3, None).0.camera_from_icrs.angle_to(&scan.frame(4, None).0.camera_from_icrs);
        assert!((step - 3.7e-3).abs() < 1e-9);
        assert_eq!(scan.frame(50, None).1.sequence, 1);
    }
}
