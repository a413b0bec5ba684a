//! Exchanges and mirrorings of the axes of a frame.

/// A symmetry of the frame: how labels would have to be changed to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Symmetry {
    is_exchanged: bool,
    mirrored: [bool; 2],
}

impl Symmetry {
    pub(super) const ALL: [Self; 8] = {
        let mut all = [Self { is_exchanged: false, mirrored: [false; 2] }; 8];
        let mut number = 1;
        while number < 8 {
            all[number] = Self { is_exchanged: number & 1 != 0, mirrored: [number & 2 != 0, number & 4 != 0] };
            number += 1;
        }
        all
    };

    pub(super) fn words(self) -> &'static str {
        match (self.is_exchanged, self.mirrored) {
            (false, [false, false]) => "as they are",
            (true, [false, false]) => "with x and y exchanged",
            (false, [true, false]) => "with x mirrored",
            (false, [false, true]) => "with y mirrored",
            (false, [true, true]) => "with x and y mirrored",
            (true, [true, false]) => "with x and y exchanged and then x mirrored",
            (true, [false, true]) => "with x and y exchanged and then y mirrored",
            (true, [true, true]) => "with x and y exchanged and then both mirrored",
        }
    }

    pub(super) fn applied(self, [x, y]: [f64; 2], [width_px, height_px]: [usize; 2]) -> [f64; 2] {
        let [x, y] = if self.is_exchanged { [y, x] } else { [x, y] };
        let mirror = |at: f64, side: usize, is_mirrored: bool| if is_mirrored { side as f64 - 1.0 - at } else { at };
        [mirror(x, width_px, self.mirrored[0]), mirror(y, height_px, self.mirrored[1])]
    }
}
