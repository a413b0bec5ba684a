//! What is known of an effect beside its equation: how large it is in real cameras, what its profile is drawn against, how it stands to others.

/// A size that real cameras or skies have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UsualSize {
    /// Of the first parameter, in its unit.
    FirstParameter(f64),
    /// Of the largest displacement of a star image, px: for coefficients whose numbers say little without the field.
    LargestPx(f64),
}

/// An ordinary size and where it is from. Where sources give a range, its geometric mean or what a commercial lens on a small detector has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrdinarySize {
    /// The size.
    pub size: UsualSize,
    /// The range and the publication.
    pub source: &'static str,
}

impl OrdinarySize {
    /// Of the first parameter.
    #[must_use]
    pub const fn of(value: f64, source: &'static str) -> Self {
        Self { size: UsualSize::FirstParameter(value), source }
    }

    /// Of the largest displacement.
    #[must_use]
    pub const fn largest_px(px: f64, source: &'static str) -> Self {
        Self { size: UsualSize::LargestPx(px), source }
    }
}

/// Parameters that a calibration lets free together where it asks the star images which of them they support.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelGroup {
    /// Their names, as a calibration is asked for them.
    pub names: &'static [&'static str],
    /// Of groups that are equally good the one with the least is taken; the groups of the reference model come before all.
    pub preference: u8,
    /// Whether they are the next term of the radial distortion. Such terms are also tried several together, and beside a model that is given.
    pub is_radial_term: bool,
}

/// The facts of a displacement. An effect states those that differ from [`Facts::NONE`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::struct_excessive_bools, reason = "facts that have nothing to do with each other")]
pub struct Facts {
    /// How large it ordinarily is. Everything that a diagnosis tries has one.
    pub ordinary_size: Option<OrdinarySize>,
    /// The same of any later parameter where only such are fitted, in their unit.
    pub ordinary_component: Option<f64>,
    /// The covariates that its profile is drawn against: the beginning of a parameter's name, and the covariate's name.
    pub profile_covariates: &'static [(&'static str, &'static str)],
    /// The name of the covariate that is its own displacement, if residuals are to be held against that.
    pub covariate: Option<&'static str>,
    /// Of effects that leave the same trace the one of the least rank gives the name.
    pub name_rank: u8,
    /// What place, air and clock leave open of a size that is known, as a share.
    pub open_share: f64,
    /// Whether its first parameter is a difference from what the model holds (an epoch): another value than the known one is a finding then.
    pub counts_from_model: bool,
    /// Whether it follows the zenith, which is searched for where place and time do not tell it.
    pub searches_zenith: bool,
    /// Whether its size goes with the level of the sky, so that it need not be the same through a recording.
    pub follows_sky_level: bool,
    /// Whether it is a part of every camera, with parameters of the camera's own.
    pub is_of_every_camera: bool,
    /// Whether a mirror leaves it as it is.
    pub is_even_in_mirror: bool,
    /// What keeps it from being computed where its own requirements are met and its size is not known.
    pub unknown_size: &'static str,
    /// Parameters that show more of it than the typical ones on the small frame of its picture.
    pub demo_sizes: &'static [(&'static str, f64)],
    /// Why no scene of its own shows it, if none does.
    pub not_shown: Option<&'static str>,
    /// Short names that the field uses where a calibration is asked to solve for it, and the parameter that each means; without one, the whole effect.
    pub short_names: &'static [(&'static str, Option<&'static str>)],
    /// What of it belongs to a camera that is selected by the data: each group is let free or left out as one.
    pub model_groups: &'static [ModelGroup],
}

impl Facts {
    /// Nothing is known.
    pub const NONE: Self = Self {
        ordinary_size: None,
        ordinary_component: None,
        profile_covariates: &[],
        covariate: None,
        name_rank: 1,
        open_share: 0.0,
        counts_from_model: false,
        searches_zenith: false,
        follows_sky_level: false,
        is_of_every_camera: false,
        is_even_in_mirror: false,
        unknown_size: "its size must be fitted",
        demo_sizes: &[],
        not_shown: None,
        short_names: &[],
        model_groups: &[],
    };

    /// The covariate that the profile of a parameter is drawn against.
    #[must_use]
    pub fn profile_covariate(&self, parameter: &str) -> Option<&'static str> {
        self.profile_covariates.iter().find(|(beginning, _)| parameter.starts_with(beginning)).map(|(_, covariate)| *covariate)
    }
}

/// The id of an effect as the names of files, functions and shaders have it: `hot_pixels` of `hot-pixels`.
#[must_use]
pub fn stem_of(id: &str) -> String {
    id.chars().map(|letter| if letter == '-' { '_' } else { letter }).collect()
}

/// The id that a user means: `hot-pixels` and `hot_pixels` are one.
///
/// ```
/// assert_eq!(boresight::effects::id_of("hot_pixels"), "hot-pixels");
/// assert_eq!(boresight::effects::stem_of("hot-pixels"), "hot_pixels");
/// ```
#[must_use]
pub fn id_of(text: &str) -> String {
    text.chars().map(|letter| if letter == '_' { '-' } else { letter }).collect()
}
