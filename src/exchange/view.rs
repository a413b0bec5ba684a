//! Meaning of a header's world coordinates: the light as it arrives, in camera axes, or catalogue places, through all effects on the way.

use nalgebra::{UnitQuaternion, Vector3};

use super::SubjectFrame;
use crate::camera::{Model, SkyChain};
use crate::coordinates::{Attitude, CameraAxes, Direction, Icrs, PixelPoint};
use crate::effects::{Context, StarState};

/// A camera, alone or under a sky.
pub(super) struct View<'a> {
    model: &'a Model,
    context: Context,
    sky: Option<Sky<'a>>,
}

/// One exposure's way from the catalogue to the camera.
struct Sky<'a> {
    chain: &'a SkyChain,
    attitude: Attitude,
    placed: Attitude,
}

impl<'a> View<'a> {
    /// The camera alone: directions are those of the light as it arrives, in camera axes.
    pub(super) fn of_camera(model: &'a Model) -> Self {
        Self { model, context: model.reference_context(), sky: None }
    }

    /// One exposure: directions are places of the catalogue, in the axes of [`Self::attitude`]. `None` where nothing says what is done to the light.
    pub(super) fn of_places(model: &'a Model, frame: &'a SubjectFrame) -> Option<Self> {
        let chain = frame.sky.as_ref()?;
        let camera = model.reference_context();
        let mut observation = *chain.observation();
        observation.sensor = observation.sensor.or(camera.observation.sensor);
        let boresight = frame.attitude.apparent_from_camera(&Direction::from_unit([0.0, 0.0, 1.0]));
        let place = chain.icrs_from_apparent(&boresight);
        let turn = UnitQuaternion::rotation_between(&Vector3::from(place.xyz), &Vector3::from(boresight.xyz)).unwrap_or_default();
        let placed = Attitude::new(frame.attitude.camera_from_icrs * turn);
        let sky = Some(Sky { chain, attitude: frame.attitude, placed });
        Some(Self { model, context: Context::new(camera.star, observation), sky })
    }

    /// The camera.
    pub(super) fn model(&self) -> &Model {
        self.model
    }

    /// The attitude of the axes in which directions are given, where they are places of the catalogue: its z is the place of the boresight's light.
    pub(super) fn attitude(&self) -> Option<Attitude> {
        self.sky.as_ref().map(|sky| sky.placed)
    }

    /// The direction of a pixel of the un-mirrored frame.
    pub(super) fn direction(&self, [x_px, y_px]: [f64; 2]) -> Option<[f64; 3]> {
        let seen = self.model.direction(PixelPoint { x_px, y_px }, &self.context)?;
        let Some(sky) = &self.sky else { return Some(seen.xyz) };
        let place = sky.chain.icrs_from_apparent(&sky.attitude.apparent_from_camera(&seen));
        let own = sky.placed.camera_from_icrs * Vector3::from(place.xyz);
        own.iter().all(|c| c.is_finite()).then_some([own.x, own.y, own.z])
    }

    /// The pixel of the un-mirrored frame on which a direction is seen.
    pub(super) fn pixel(&self, direction: [f64; 3]) -> Option<[f64; 2]> {
        let seen = match &self.sky {
            None => Direction::<CameraAxes>::from_unit(direction),
            Some(sky) => {
                let place = sky.placed.camera_from_icrs.inverse() * Vector3::from(direction);
                let place = Direction::<Icrs>::along([place.x, place.y, place.z]);
                sky.attitude.camera_from_apparent(
                    &sky.chain.apparent_in(&StarState { direction: place.xyz, ..sky.chain.still_star() }, sky.chain.observation()),
                )
            }
        };
        self.model.pixel(&seen, &self.context).map(|point| [point.x_px, point.y_px])
    }
}
