//! Labels of pixels: what each shows, and how far it is from the nearest star.

use crate::render::{Footprint, MaskFlag};

/// What a pixel shows; in the order in which one goes before another, the weakest first.
pub const PIXEL_CLASSES: [(&str, &str); 9] = [
    ("sky", "nothing that is told apart from the background"),
    ("star", "a star of the catalogue is expected to stand above the noise of everything else in the pixel"),
    ("false-star", "the same of a light that looks like a star and is none"),
    ("ghost", "ghosts of stars leave half an electron or more, each"),
    ("trail", "a satellite or a meteor leaves half an electron or more"),
    ("cosmic-ray", "a particle leaves half an electron or more"),
    ("telegraph", "a telegraph pixel is in its high state"),
    ("hot", "a defect adds charge in this frame"),
    ("dead", "the pixel gives nothing"),
];

pub(super) const STAR: u8 = 1;
const FALSE_STAR: u8 = 2;
const TRAIL: u8 = 4;

/// Flags of the renderer with the class of each, the weakest first.
const OF_FLAGS: [(u16, u8); 6] = [
    (MaskFlag::GHOST, 3),
    (MaskFlag::TRAIL, TRAIL),
    (MaskFlag::COSMIC_RAY, 5),
    (MaskFlag::TELEGRAPH, 6),
    (MaskFlag::HOT, 7),
    (MaskFlag::DEAD, 8),
];

/// The class of every pixel. `flags`: the renderer's mask; footprints of stars, and of lights that look like them.
pub(super) fn classes<'f>(
    flags: &[u16],
    stars: impl Iterator<Item = &'f Footprint>,
    false_stars: impl Iterator<Item = &'f Footprint>,
) -> Vec<u8> {
    /// Pixels that are looked at together: most have no flag.
    const RUN_PX: usize = 64;
    let mut classes = vec![0; flags.len()];
    // A false star is a trail of no length to the renderer.
    for (classes, flags) in classes.chunks_mut(RUN_PX).zip(flags.chunks(RUN_PX)) {
        if flags.iter().fold(0, |all, own| all | own) == 0 {
            continue;
        }
        for (own, flags) in classes.iter_mut().zip(flags) {
            for (flag, class) in OF_FLAGS {
                if flags & flag != 0 {
                    *own = class;
                }
            }
        }
    }
    let mut put = |footprint: &Footprint, class: u8, over: &dyn Fn(u8) -> bool| {
        for (pixel, _) in &footprint.pixels {
            let own = &mut classes[*pixel as usize];
            if over(*own) {
                *own = class;
            }
        }
    };
    stars.for_each(|footprint| put(footprint, STAR, &|own| own == 0));
    false_stars.for_each(|footprint| put(footprint, FALSE_STAR, &|own| own <= STAR || own == TRAIL));
    classes
}

/// For every pixel the light that is brightest there: 1 for the first of the labels, and so on; 0: none stands above the noise. Lights behind the
/// 65,535th have no pixel.
pub(super) fn instances(pixels: usize, footprints: &[Footprint]) -> Vec<u16> {
    let (mut own, mut brightest_e) = (vec![0; pixels], vec![0.0_f32; pixels]);
    for (number, footprint) in (1..=u16::MAX).zip(footprints) {
        for (pixel, electrons) in &footprint.pixels {
            let pixel = *pixel as usize;
            if *electrons > brightest_e[pixel] {
                (own[pixel], brightest_e[pixel]) = (number, *electrons);
            }
        }
    }
    own
}

/// The largest distance that is told, in pixels, and steps of a pixel.
const FAR_PX: f32 = 32.0;
const STEPS_PER_PX: f32 = 8.0;

/// For every pixel how far its centre is from the nearest of these places: eighths of a pixel, 255 from 31.875 px on.
pub(super) fn distances([width_px, height_px]: [usize; 2], places: impl Iterator<Item = [f64; 2]>) -> Vec<u8> {
    let mut squares = vec![FAR_PX * FAR_PX; width_px * height_px];
    for [x, y] in places {
        let span = |at: f64, side: usize| {
            let (low, high) = ((at - f64::from(FAR_PX)).ceil().max(0.0), (at + f64::from(FAR_PX)).floor().min(side as f64 - 1.0));
            if low <= high { low as usize..high as usize + 1 } else { 0..0 }
        };
        let columns = span(x, width_px);
        for row in span(y, height_px) {
            let of_row = (row as f64 - y) as f32;
            let of_row = of_row * of_row;
            let pixels = &mut squares[row * width_px + columns.start..row * width_px + columns.end];
            let mut along = (columns.start as f64 - x) as f32;
            for square in pixels {
                *square = square.min(along * along + of_row);
                along += 1.0;
            }
        }
    }
    squares.into_iter().map(|square| (STEPS_PER_PX * square.sqrt() + 0.5) as u8).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_to_the_nearest_place() {
        let places = [[3.25, 4.0], [60.0, 10.5], [-5.0, 20.0]];
        let found = distances([70, 50], places.into_iter());
        for (pixel, found) in found.iter().enumerate() {
            let (x, y) = ((pixel % 70) as f64, (pixel / 70) as f64);
            let nearest = places.iter().map(|place| (place[0] - x).hypot(place[1] - y)).fold(f64::INFINITY, f64::min);
            assert!((f64::from(*found) / 8.0 - nearest.min(31.875)).abs() < 0.07, "({x}, {y}): {found} eighths instead of {nearest} px");
        }
        assert!(distances([4, 4], std::iter::empty()).iter().all(|distance| *distance == 255));
    }

    #[test]
    fn a_pixel_belongs_to_the_light_that_is_brightest_there() {
        let of = |pixels: &[(u32, f32)]| Footprint { pixels: pixels.to_vec(), ..Footprint::default() };
        assert_eq!(instances(5, &[of(&[(0, 9.0), (1, 5.0)]), of(&[(1, 6.0), (3, 1.0)]), of(&[])]), [1, 2, 0, 2, 0]);
    }

    #[test]
    fn defects_go_before_stars_and_stars_before_the_sky() {
        let flags = [0, 0, MaskFlag::HOT, MaskFlag::SATURATED, MaskFlag::TRAIL, MaskFlag::TRAIL];
        let star = Footprint { pixels: vec![(1, 9.0), (2, 9.0), (3, 9.0), (4, 9.0)], ..Footprint::default() };
        let other = Footprint { pixels: vec![(3, 1.0), (5, 1.0)], ..Footprint::default() };
        assert_eq!(classes(&flags, [&star].into_iter(), [&other].into_iter()), [0, 1, 7, 2, 4, 2]);
        assert_eq!(PIXEL_CLASSES[7].0, "hot");
    }
}
