//! Dragging the selected node with the pointer.

use glam::{DAffine3, DMat3, DVec3};
use ropewalk::{Core, NodeKey, Scene, Transform};

use crate::projection::Ray;

/// Which transform a drag changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Moves {
    /// The nearest transform at or above the selected node.
    #[default]
    Object,
    /// The next transform above that one, with the whole subtree.
    Group,
}

/// The axis constraint of a drag, in world space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Axis {
    X,
    Y,
    Z,
}

/// A drag in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drag {
    /// The transform node that is moved.
    pub(crate) node: NodeKey,
    /// Its local transform when the drag started.
    start: Transform,
    parent_from_world: DMat3,
    /// The point of the surface at which the drag started, in world space.
    pub(crate) anchor: DVec3,
    /// The normal of the plane through the anchor in which the drag moves it.
    normal: DVec3,
}

/// The transform node that a drag of `node` moves; `None` if there is none.
pub(crate) fn moved_by(scene: &Scene, node: NodeKey, moves: Moves) -> Option<NodeKey> {
    let above = scene.ancestors(node).into_iter().flatten();
    let mut transforms =
        std::iter::once(node).chain(above).filter(|&node| matches!(scene.node_core(node), Ok(Core::Transform(_))));
    let nearest = transforms.next()?;
    match moves {
        Moves::Object => Some(nearest),
        Moves::Group => Some(transforms.next().unwrap_or(nearest)),
    }
}

impl Drag {
    /// Starts a drag of a transform node at a point in world space, in the plane with this normal. `None` if the node's
    /// parent has a singular world transform.
    pub(crate) fn begin(scene: &Scene, node: NodeKey, anchor: DVec3, normal: DVec3) -> ropewalk::Result<Option<Self>> {
        let start = scene.local(node)?;
        let parent_world =
            scene.parent(node)?.map_or(Ok(DAffine3::IDENTITY), |parent| scene.world_from_local(parent))?;
        let parent_from_world = parent_world.matrix3.inverse();
        let is_regular = parent_from_world.is_finite();
        Ok(is_regular.then_some(Self { node, start, parent_from_world, anchor, normal }))
    }

    /// The local transform that brings the anchor under the pointer; `None` if none does.
    pub(crate) fn to(&self, ray: Ray, axis: Option<Axis>) -> Option<Transform> {
        let offset = match axis {
            None => self.in_plane(ray)?,
            Some(axis) => self.along(ray, axis)?,
        };
        Some(translated(self.start, self.parent_from_world * offset))
    }

    /// The offset of the anchor in the drag's plane, in world space.
    fn in_plane(&self, ray: Ray) -> Option<DVec3> {
        let distance = (self.anchor - ray.origin).dot(self.normal) / ray.direction.dot(self.normal);
        (distance.is_finite() && distance > 0.0).then(|| ray.origin + ray.direction * distance - self.anchor)
    }

    /// The offset of the anchor along an axis, to the point nearest to the ray, in world space.
    fn along(&self, ray: Ray, axis: Axis) -> Option<DVec3> {
        /// Below this squared sine between ray and axis, the nearest point is ill-conditioned.
        const MIN_SINE_SQUARED: f64 = 1e-4;

        let axis = match axis {
            Axis::X => DVec3::X,
            Axis::Y => DVec3::Y,
            Axis::Z => DVec3::Z,
        };
        let (offset, cosine) = (self.anchor - ray.origin, axis.dot(ray.direction));
        let sine_squared = 1.0 - cosine * cosine;
        let distance = (cosine * offset.dot(ray.direction) - offset.dot(axis)) / sine_squared;
        (sine_squared > MIN_SINE_SQUARED && distance.is_finite()).then_some(axis * distance)
    }
}

/// The transform moved in its parent's space; its variant stays.
fn translated(transform: Transform, offset: DVec3) -> Transform {
    let (Transform::Trs { translation, .. }
    | Transform::Pivoted { translation, .. }
    | Transform::Matrix(DAffine3 { translation, .. })) = transform;
    transform.with_translation(translation + offset)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec2, dvec2, dvec3};
    use ropewalk::{Camera, View};

    use super::*;
    use crate::projection::Projection;

    /// A rotated and scaled parent, a child that is a matrix, and a leaf.
    fn scene() -> (Scene, [NodeKey; 3]) {
        let mut scene = Scene::new();
        let parent = Transform::Trs {
            translation: dvec3(1.0, 2.0, 3.0),
            rotation: DQuat::from_rotation_y(0.7),
            scale: dvec3(2.0, 0.5, -1.0),
        };
        let parent = scene.add(scene.root(), parent).unwrap();
        let child = Transform::Matrix(DAffine3::from_scale(dvec3(1.0, 2.0, 3.0)));
        let child = scene.add(parent, child).unwrap();
        let leaf = scene.add(child, Core::Group).unwrap();
        (scene, [parent, child, leaf])
    }

    #[test]
    fn the_anchor_stays_under_the_pointer() {
        let (mut scene, [_, child, _]) = scene();
        let view = View::look_at(dvec3(4.0, 5.0, 9.0), dvec3(1.0, 2.0, 3.0), DVec3::Y, Camera::default(), 300, 200);
        let projection = Projection::of(&view);
        let grab = projection.ray(dvec2(140.0, 90.0));
        let anchor = grab.origin + grab.direction * 6.0;
        let in_child = scene.world_from_local(child).unwrap().inverse().transform_point3(anchor);
        let drag = Drag::begin(&scene, child, anchor, projection.forward()).unwrap().unwrap();
        for target in [dvec2(140.0, 90.0), dvec2(10.0, 5.0), dvec2(280.5, 190.0)] {
            scene.set_local(child, drag.to(projection.ray(target), None).unwrap()).unwrap();
            let now = scene.world_from_local(child).unwrap().transform_point3(in_child);
            assert!(seen_at(&projection, now).distance(target) < 1e-6, "{target}");
        }
    }

    #[test]
    fn an_axis_holds_the_other_coordinates() {
        let (mut scene, [parent, _, _]) = scene();
        let view = View::look_at(dvec3(4.0, 5.0, 9.0), dvec3(1.0, 2.0, 3.0), DVec3::Y, Camera::default(), 300, 200);
        let projection = Projection::of(&view);
        let anchor = scene.world_from_local(parent).unwrap().translation;
        let drag = Drag::begin(&scene, parent, anchor, projection.forward()).unwrap().unwrap();
        for (axis, free) in [(Axis::X, 0), (Axis::Y, 1), (Axis::Z, 2)] {
            // A pointer at another point of the axis takes the anchor there.
            let mut wanted = anchor;
            wanted[free] += 0.8;
            let ray = projection.ray(seen_at(&projection, wanted));
            scene.set_local(parent, drag.to(ray, Some(axis)).unwrap()).unwrap();
            assert!(scene.world_from_local(parent).unwrap().translation.distance(wanted) < 1e-9, "{axis:?}");
        }
    }

    #[test]
    fn a_drag_moves_the_nearest_transform_or_the_next_above() {
        let (scene, [parent, child, leaf]) = scene();
        assert_eq!(moved_by(&scene, leaf, Moves::Object), Some(child));
        assert_eq!(moved_by(&scene, leaf, Moves::Group), Some(parent));
        assert_eq!(moved_by(&scene, parent, Moves::Group), Some(parent));
        assert_eq!(moved_by(&scene, scene.root(), Moves::Object), None);
    }

    #[test]
    fn below_a_flattened_parent_nothing_can_be_dragged() {
        let (mut scene, [parent, child, _]) = scene();
        scene.set_local(parent, Transform::from_scale(DVec3::ZERO)).unwrap();
        assert!(Drag::begin(&scene, child, DVec3::ZERO, DVec3::Z).unwrap().is_none());
    }

    fn seen_at(projection: &Projection, point: DVec3) -> DVec2 {
        projection.segment(point, point + projection.forward()).unwrap()[0]
    }
}
