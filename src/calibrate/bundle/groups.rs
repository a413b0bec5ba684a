//! What a selection of the camera's parameters lets free together: the reference model's own groups, and what each effect says of itself
//! ([`ModelGroup`]).

use crate::effects::{DISPLACEMENTS, ModelGroup};
use crate::statistics::order::sort_by_key;

/// A set of names that are let free together.
pub(super) type Group = &'static [&'static str];
/// The first term of the radial distortion.
const FIRST_RADIAL: Group = &["k1"];
/// What of the reference model is let free together, in the order of preference where two are equally good.
const REFERENCE: [Group; 3] = [FIRST_RADIAL, CENTRE, &["p1", "p2"]];
/// The principal point.
pub(super) const CENTRE: &[&str] = &["x0", "y0"];

/// What the effects add to the reference model, in the order of preference.
fn of_effects() -> Vec<ModelGroup> {
    let mut groups: Vec<ModelGroup> = DISPLACEMENTS.iter().flat_map(|effect| effect.facts().model_groups).copied().collect();
    sort_by_key(&mut groups, |group| group.preference); // stable: the order of the light decides between equals
    groups
}

/// What is let free together, in the order of preference where two are equally good.
pub(super) fn all_groups() -> Vec<Group> {
    REFERENCE.into_iter().chain(of_effects().iter().map(|group| group.names)).collect()
}

/// What is left out of the fullest model where the star images do not determine it, one after the other: the least preferred first. The first
/// term of the radial distortion stays.
pub(super) fn dropped() -> impl Iterator<Item = Group> {
    all_groups().into_iter().rev().filter(|group| *group != FIRST_RADIAL)
}

/// What is let free beside parameters that are solved in any case.
pub(super) fn higher_radial() -> impl Iterator<Item = Group> {
    of_effects().into_iter().filter(|group| group.is_radial_term).map(|group| group.names)
}

/// The radial distortion, term by term.
pub(super) fn radial() -> impl Iterator<Item = Group> {
    std::iter::once(FIRST_RADIAL).chain(higher_radial())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_effects_add_their_groups_in_the_order_of_preference() {
        let groups: [Group; 7] = [&["k1"], &["x0", "y0"], &["p1", "p2"], &["k2"], &["k3"], &["aspect"], &["quadratic-rest"]];
        assert_eq!(all_groups(), groups);
        let backwards: [Group; 6] = [&["quadratic-rest"], &["aspect"], &["k3"], &["k2"], &["p1", "p2"], &["x0", "y0"]];
        assert_eq!(dropped().collect::<Vec<_>>(), backwards);
        assert_eq!(radial().collect::<Vec<_>>(), [&["k1"], &["k2"], &["k3"]]);
        assert_eq!(higher_radial().collect::<Vec<_>>(), [&["k2"], &["k3"]]);
    }

    #[test]
    fn every_name_of_a_group_is_one_that_can_be_solved() {
        for name in all_groups().concat() {
            assert!(super::super::is_reference(name) || super::super::solve_for::is_solvable(name), "{name}");
        }
    }
}
