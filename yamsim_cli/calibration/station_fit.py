"""Fit cameras, bases, joint offsets and delays together to the outlines of the arms in all chosen pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.attempt_data import ArmPosture
from ..core.config.rig import RigConfig
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_vector, rotation_z
from ..photos.edge_alignment import (
    EdgeOffsets,
    MaskOutline,
    PoseCorrection,
    edge_offsets,
    edge_spread,
    edge_weights,
    grain_px,
    mask_outline,
    points_in_camera,
)
from ..photos.overlay.body_views import BodyPicture, BodyRenderer, JointAxes
from .camera_start import CameraPrior, fitted_k1
from .chosen_frames import CHANGE_BLUR, ChosenFrame
from .episode_pictures import EpisodePictures

_REACHES = (16.0, 10.0, 7.0, 5.0, 3.5, 2.5, 2.5, 2.5, 2.5, 2.5)  # grains, search distance for edges by round
EDGE_SIGMA = 0.12  # grains, least standard deviation of an edge's position
# Factor on the standard deviation of an edge's position. Edges are not independent: meshes and light shift an edge
# alike in all pictures. With a factor of 1, errors of planted stations were up to 1.6 half widths of their intervals,
# and a fit moved a given focal length too far.
SHARED_ERRORS = 1.8
_STILL_PICTURES = 3.0  # pictures that count as independent for the outlines of bodies that stand still
_CONVERGED = 2e-5  # m, movement of the arms in a round, below which the fit ends
_ARM_REACH = 0.4  # m, from the middle of the arms to their ends, about
MOVING, STILL, UNCLEAR = 1, 2, 3  # kinds of bodies in a picture
_PIXEL_BLUR = 0.29  # px, standard deviation of a pixel's own area
_FULL = 250  # grey level of rendered bodies
_RENDERED_REACH = 2.5  # grains, within which the edge of a rendered body is searched
_MOSTLY = 0.5  # share of pictures in which a body is still, for the biases of still bodies
_MIN_LINE = 10  # outline points; a shorter outline is not used

# Parameters of a camera, in order: the turn and shift of its pose, the logarithm of its focal length, its delay (s),
# a margin (px), the distortion k1 that remains in the undistorted pictures, and biases (px). The margin is the
# distance of edges from outlines, and is the same for all bodies. Each body has three biases of its edges: outwards,
# to the right and down. They are the same in all pictures. Light, shadows and simplified meshes cause them.
FOCAL, DELAY, MARGIN, LENS, BIASES = 6, 7, 8, 9, 10
_BIASES = 3  # of each body


@dataclass(frozen=True)
class FitPriors:
    """Standard deviations of what is known before the fit.

    Attributes:
        cameras: of each camera.
        delay: s.
        offset: of a joint, rad.
        base_shift, base_turn: of the second base in the first one, m and rad.
        margin: of the common distance of edges from outlines, px.
        biases: of a moving body's edges outwards, and to the right and down, px.
        still_biases: the same of a still body, whose background is not known.
    """

    cameras: tuple[CameraPrior, ...] = ()
    delay: float = 0.06
    offset: float = math.radians(1.0)
    base_shift: float = 0.03
    base_turn: float = math.radians(3.0)
    margin: float = 0.5
    biases: tuple[float, float, float] = (0.15, 0.1, 0.1)
    still_biases: tuple[float, float, float] = (0.3, 0.3, 0.3)


_HELD = 1e-7  # least standard deviation of a prior: a value whose prior has the deviation 0 stays at its start


@dataclass(frozen=True)
class StationState:
    """The estimated values.

    Attributes:
        T_base_in_cam: pose (4, 4) of the reference arm's base in each camera. Bases are those in which the measured
            first joint is true, because an offset of it turns all links like a turn of the base.
        log_focal: logarithm of each camera's focal length over the given one.
        delays: of each camera, s: its pictures show the arms as they were this much earlier than stamped.
        margins: of each camera, px.
        lenses: of each camera: OpenCV's distortion k1 that remains after its pictures were undistorted.
        biases: of each camera's bodies (3 x nbody,), px.
        offsets: of each arm's joints (dof,), rad: measured minus true. That of the first joint is how far the base
            body is turned from the base in which the measured joint is true.
        T_arm_in_base: pose (4, 4) of each arm's base in the reference arm's base.
    """

    T_base_in_cam: tuple[Array, ...]
    log_focal: tuple[float, ...]
    delays: tuple[float, ...]
    margins: tuple[float, ...]
    lenses: tuple[float, ...]
    biases: tuple[Array, ...]
    offsets: tuple[Array, ...]
    T_arm_in_base: tuple[Array, ...]

    def postures(self, episode: EpisodePictures, time: float, camera: int) -> tuple[ArmPosture, ...]:
        """Return the true postures in a camera's picture with a time stamp, s."""
        return episode.postures_at(time - self.delays[camera], self.offsets)

    def base_poses(self, camera: int) -> dict[int, Array]:
        """Return the pose (4, 4) of each arm's base in a camera, at which `postures` puts the links in place.

        This is the base body's own pose: turned by the first joint's offset from the one in `T_arm_in_base`. The first
        joint of each arm turns about the z axis of its base.
        """
        return {
            arm: self.T_base_in_cam[camera] @ T @ pose(rotation=rotation_z(float(self.offsets[arm][0])))
            for arm, T in enumerate(self.T_arm_in_base)
        }


@dataclass(frozen=True)
class FittedCameraView:
    """A camera's pictures.

    Attributes:
        frames: the chosen pictures.
        kinds: `MOVING`, `STILL` or `UNCLEAR` of each body in each picture (frames, nbody).
    """

    name: str
    renderer: BodyRenderer
    frames: tuple[ChosenFrame, ...]
    kinds: NDArray[np.uint8]

    def set_state(self, state: StationState, camera: int, episodes: Sequence[EpisodePictures], frame: int) -> None:
        """Pose the renderer's arms as in a picture."""
        shown = self.frames[frame]
        self.show(state, camera, episodes[shown.episode], shown.time)

    def show(self, state: StationState, camera: int, episode: EpisodePictures, time: float) -> None:
        """Pose the renderer's arms as in a picture with a time stamp, s."""
        self.renderer.set_focal_scale(math.exp(state.log_focal[camera]))
        self.renderer.set_poses(state.base_poses(camera), state.postures(episode, time, camera))


@dataclass(frozen=True)
class Layout:
    """Places of parameters in the vector of all."""

    cameras: int
    bodies: int
    dofs: tuple[int, ...]
    reference: int

    @property
    def camera_size(self) -> int:
        """Number of a camera's parameters."""
        return BIASES + _BIASES * self.bodies

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.camera_size * self.cameras + sum(self.dofs) + 6 * (len(self.dofs) - 1)

    def camera(self, number: int) -> slice:
        """Place of a camera's parameters."""
        return slice(self.camera_size * number, self.camera_size * (number + 1))

    def offsets(self, arm: int) -> slice:
        """Place of an arm's joint offsets."""
        start = self.camera_size * self.cameras + sum(self.dofs[:arm])
        return slice(start, start + self.dofs[arm])

    def base(self, arm: int) -> slice | None:
        """Place of the turn and shift of an arm's base; None for the reference arm."""
        if arm == self.reference:
            return None
        others = [k for k in range(len(self.dofs)) if k != self.reference]
        start = self.camera_size * self.cameras + sum(self.dofs) + 6 * others.index(arm)
        return slice(start, start + 6)


@dataclass(frozen=True)
class FrameEquations:
    """The weighted equations of one picture.

    Attributes:
        normal, right_hand_side: (k, k) and (k,), of the normal equations for all parameters.
        points: number of outline points.
        found: number of outline points with an edge of the picture within reach.
        median: median distance of these points from their edges, px.
    """

    camera: int
    frame: int
    normal: Array
    right_hand_side: Array
    points: int
    found: int
    median: float


@dataclass(frozen=True)
class StationFit:
    """The result: values, and the equations of each picture at these values.

    Attributes:
        prior: inverse covariance (k, k) of what was known before.
        centres: points (3,) in the cameras' frames about which poses turn.
    """

    layout: Layout
    state: StationState
    equations: tuple[FrameEquations, ...]
    prior: Array
    centres: tuple[Array, ...]


class StationProblem:
    """The fit of a station to its pictures."""

    def __init__(
        self, rig: RigConfig, views: Sequence[FittedCameraView], episodes: Sequence[EpisodePictures], priors: FitPriors
    ) -> None:
        self.views, self.episodes = views, episodes
        self._rig, self._priors = rig, priors
        bodies = len(views[0].renderer.arm_of_body)
        self.layout = Layout(len(views), bodies, tuple(arm.robot.dof for arm in rig.arms), rig.recording_order[0])
        sigma = np.full(self.layout.size, np.inf)
        for number, view in enumerate(views):
            start = self.layout.camera(number).start
            sigma[start + FOCAL] = max(priors.cameras[number].focal, _HELD)
            sigma[start + DELAY] = max(priors.delay, _HELD)
            sigma[start + MARGIN] = priors.margin
            sigma[start + LENS] = max(priors.cameras[number].lens, _HELD)
            still = (view.kinds == STILL).mean(axis=0) > _MOSTLY
            biases = np.where(still[:, None], priors.still_biases, priors.biases)
            sigma[start + BIASES : self.layout.camera(number).stop] = biases.ravel()
        for arm in range(len(rig.arms)):
            sigma[self.layout.offsets(arm)] = max(priors.offset, _HELD)
            if (place := self.layout.base(arm)) is not None:
                sigma[place] = [priors.base_turn] * 3 + [priors.base_shift] * 3
        self.sigma = sigma

    def fit(self, state: StationState, reaches: Sequence[float] = _REACHES) -> StationFit:
        """Return the fit that starts at a state; the start does not change what the priors assume."""
        for number, reach in enumerate(reaches):
            equations, centres = self.linearize(state, reach)
            prior, towards_prior = self._prior_equations(state)
            normal = prior + sum(one.normal for one in equations)
            right_hand_side = towards_prior + sum(one.right_hand_side for one in equations)
            damped = normal + 1e-9 * np.diag(np.diag(normal) + 1e-12)
            step: Array = np.linalg.solve(damped, right_hand_side).astype(np.float64)
            state = self.apply(state, step, centres)
            if number >= len(reaches) - 3 and self._displacement(step) < _CONVERGED:
                break
        equations, centres = self.linearize(state, reaches[-1])
        return StationFit(self.layout, state, tuple(equations), self._prior_equations(state)[0], tuple(centres))

    def _prior_equations(self, state: StationState) -> tuple[Array, Array]:
        """Return the normal equations (k, k) and (k,) of what the priors assume."""
        J = self._prior_jacobian(state)
        weighted = J.T / self.sigma**2
        return weighted @ J, -weighted @ self.prior_deviation(state)

    def _prior_jacobian(self, state: StationState) -> Array:
        """Return how the deviations from the priors' means change with the parameters (k, k).

        Only k1 depends on another parameter too: the removed k1 belongs to the focal length before the fit.
        """
        J = np.eye(self.layout.size)
        for number, prior in enumerate(self._priors.cameras):
            start = self.layout.camera(number).start
            J[start + LENS, start + FOCAL] = 2 * fitted_k1(prior.removed_k1, 0.0, state.log_focal[number])
        return J

    def with_views(self, views: Sequence[FittedCameraView]) -> StationProblem:
        """Return the same problem with other pictures of its cameras, with the same distortion removed."""
        return StationProblem(self._rig, views, self.episodes, self._priors)

    def prior_deviation(self, state: StationState) -> Array:
        """Return how far (k,) a state is from the priors' means; 0 for the cameras' poses, which have no prior."""
        deviation = np.zeros(self.layout.size)
        for number in range(self.layout.cameras):
            start = self.layout.camera(number).start
            deviation[start + FOCAL] = state.log_focal[number]
            deviation[start + DELAY] = state.delays[number]
            deviation[start + MARGIN] = state.margins[number]
            removed = self._priors.cameras[number].removed_k1
            deviation[start + LENS] = fitted_k1(removed, state.lenses[number], state.log_focal[number])
            deviation[start + BIASES : self.layout.camera(number).stop] = state.biases[number]
        for arm, (offsets, T, T_prior) in enumerate(
            zip(state.offsets, state.T_arm_in_base, rig_bases(self._rig), strict=True)
        ):
            deviation[self.layout.offsets(arm)] = offsets
            if (place := self.layout.base(arm)) is not None:
                deviation[place.start : place.start + 3] = rotation_vector(T[:3, :3] @ T_prior[:3, :3].T)
                deviation[place.start + 3 : place.stop] = T[:3, 3] - T_prior[:3, 3]
        return deviation

    def _displacement(self, step: Array) -> float:
        cameras = [step[self.layout.camera(k)] for k in range(self.layout.cameras)]
        return max(float(np.linalg.norm(one[3:6]) + _ARM_REACH * np.linalg.norm(one[:3])) for one in cameras)

    def apply(self, state: StationState, step: Array, centres: Sequence[Array]) -> StationState:
        """Return the state after a step (k,)."""
        poses, focal, delays, margins, lenses, biases = [], [], [], [], [], []
        for number, centre in enumerate(centres):
            own = step[self.layout.camera(number)]
            poses.append(PoseCorrection(own[:6], centre).apply_to_pose(state.T_base_in_cam[number]))
            focal.append(state.log_focal[number] + float(np.clip(own[FOCAL], -0.1, 0.1)))
            delays.append(state.delays[number] + float(own[DELAY]))
            margins.append(state.margins[number] + float(own[MARGIN]))
            lenses.append(state.lenses[number] + float(own[LENS]))
            biases.append(state.biases[number] + own[BIASES:])
        bases = list(state.T_arm_in_base)
        for arm in range(len(bases)):
            if (place := self.layout.base(arm)) is not None:
                bases[arm] = PoseCorrection(step[place], bases[arm][:3, 3]).apply_to_pose(bases[arm])
        offsets = tuple(rows + step[self.layout.offsets(arm)] for arm, rows in enumerate(state.offsets))
        return StationState(
            tuple(poses),
            tuple(focal),
            tuple(delays),
            tuple(margins),
            tuple(lenses),
            tuple(biases),
            offsets,
            tuple(bases),
        )

    def linearize(self, state: StationState, reach: float) -> tuple[list[FrameEquations], list[Array]]:
        """Return the equations of each picture, and the points about which the cameras' poses turn."""
        rows: list[_FrameRows] = []
        centres = []
        for number, view in enumerate(self.views):
            # The middle of the base: turns about it are about those of the camera.
            centre = state.T_base_in_cam[number] @ np.array([0.2, 0.0, 0.2, 1.0])
            centres.append(centre[:3])
            rows += [self._frame_rows(state, number, k, centre[:3], reach) for k in range(len(view.frames))]
        return list(_weighted(rows, self.layout.size)), centres

    def _frame_rows(self, state: StationState, camera: int, frame: int, centre: Array, reach: float) -> _FrameRows:
        view = self.views[camera]
        view.set_state(state, camera, self.episodes, frame)
        picture, shown = view.renderer.body_picture(), view.frames[frame]
        K = view.renderer.intrinsics.K
        K[[0, 1], [0, 1]] *= math.exp(state.log_focal[camera])
        parts = [
            (line, offsets, kind)
            for line, offsets, kind in outlines_and_edges(
                picture, shown, view.renderer.outside_photo, view.kinds[frame], reach
            )
            if len(line.points) >= _MIN_LINE
        ]
        axes = view.renderer.joint_axes()
        velocities = self.episodes[shown.episode].velocities_at(shown.time)
        jacobians, residuals, still, labels, points = [], [], [], [], 0
        for line, offsets, kind in parts:
            points += len(line.points)
            inside = np.round(line.points - 1.5 * line.normals).astype(int)
            bodies = picture.bodies[inside[:, 1], inside[:, 0]].astype(int)
            depth = picture.depth[inside[:, 1], inside[:, 0]].astype(np.float64)
            use = np.isfinite(offsets.offsets) & (bodies > 0) & (depth > 0)
            outline = _OutlinePoints(line.points[use], line.normals[use], bodies[use], depth[use])
            jacobians.append(self._jacobian(outline, K, centre, state, camera, view.renderer, axes, velocities))
            # The arms are rendered without margin, distortion and biases.
            lens = state.lenses[camera] * jacobians[-1][:, self.layout.camera(camera).start + LENS]
            by_body = state.biases[camera].reshape(-1, _BIASES)[outline.bodies]
            biases = (outline.bias_jacobian() * by_body).sum(axis=1)
            residuals.append(offsets.offsets[use] - state.margins[camera] - lens - biases)
            still.append(np.full(int(use.sum()), kind == STILL))
            labels.append(outline.bodies)
        grain = grain_px(shown.grey.shape)
        if not jacobians:
            nothing = np.zeros(0)
            empty = np.zeros((0, self.layout.size))
            return _FrameRows(camera, frame, empty, nothing, nothing > 0, nothing.astype(np.int64), 0, grain)
        return _FrameRows(
            camera,
            frame,
            np.concatenate(jacobians),
            np.concatenate(residuals),
            np.concatenate(still),
            np.concatenate(labels),
            points,
            grain,
        )

    def _jacobian(
        self,
        outline: _OutlinePoints,
        K: Array,
        centre: Array,
        state: StationState,
        camera: int,
        renderer: BodyRenderer,
        axes: Sequence[JointAxes],
        velocities: Sequence[Array],
    ) -> Array:
        """Return how far (px) outline points (n, k) move along their normals with each parameter."""
        points, across = points_in_camera(outline.pixels, outline.normals, outline.depth, K)
        J = np.zeros((len(points), self.layout.size))
        place = self.layout.camera(camera)
        own = J[:, place]
        own[:, :3], own[:, 3:6] = np.cross(points - centre, across), across
        own[:, FOCAL], own[:, LENS] = lens_jacobian(outline.pixels, outline.normals, K)
        own[:, MARGIN] = 1.0
        at = BIASES + _BIASES * outline.bodies[:, None] + np.arange(_BIASES)
        np.put_along_axis(own, at, outline.bias_jacobian(), axis=1)
        arms = renderer.arm_of_body[outline.bodies]
        for arm, joints in enumerate(axes):
            mine = arms == arm
            # Offsets are measured minus true, and later pictures show later joints.
            turned = np.cross(joints.axes[None], points[mine, None] - joints.anchors[None])
            by_joint = np.einsum("njk,nk->nj", turned, across[mine])
            moved = renderer.moved_by[arm][:, outline.bodies[mine]].T
            # An offset of the first joint turns the base body, and leaves the links at the measured joint positions.
            base_turn = by_joint[:, 0] * ~moved[:, 0]
            by_joint *= moved
            J[mine, self.layout.offsets(arm)] = -by_joint
            J[mine, self.layout.offsets(arm).start] = base_turn
            own[mine, DELAY] = -by_joint @ velocities[arm]
            if (base := self.layout.base(arm)) is not None:
                R = state.T_base_in_cam[camera][:3, :3]
                origin = (state.T_base_in_cam[camera] @ state.T_arm_in_base[arm])[:3, 3]
                J[mine, base.start : base.start + 3] = np.cross(points[mine] - origin, across[mine]) @ R
                J[mine, base.start + 3 : base.stop] = across[mine] @ R
        return J


@dataclass(frozen=True)
class _OutlinePoints:
    """Outline points with an edge: `pixels` and `normals` (n, 2), `bodies` (n,) and `depth` (n,), m."""

    pixels: Array
    normals: Array
    bodies: NDArray[np.int64]
    depth: Array

    def bias_jacobian(self) -> Array:
        """Return how far (px) edges move along the normals with their body's biases (n, 3)."""
        return np.column_stack([np.ones(len(self.normals)), self.normals])


@dataclass(frozen=True)
class _FrameRows:
    camera: int
    frame: int
    jacobian: Array
    residuals: Array
    still: NDArray[np.bool_]
    bodies: NDArray[np.int64]
    points: int
    grain: float


def outlines_and_edges(
    picture: BodyPicture,
    shown: ChosenFrame,
    outside: NDArray[np.bool_],
    kinds: NDArray[np.uint8],
    reach: float,
) -> Iterator[tuple[MaskOutline, EdgeOffsets, int]]:
    """Yield the outlines of the moving and of the still bodies with the picture's edges within `reach` (grains).

    Pixels `outside` (height, width) are not in the photo.
    """
    kind_of = np.where(picture.bodies > 0, kinds[picture.bodies], 0).astype(np.uint8)
    moving = kind_of == MOVING
    if moving.any():
        # The moving arm is where the picture differs from the background: towards its outline, the difference ends.
        line = mask_outline(moving, ((kind_of > 0) & ~moving) | ~shown.known | outside)
        seen = edge_offsets(shown.change, line, reach, falling=True)
        yield line, _without_own(seen, rendered_edges(picture, kinds == MOVING, line, CHANGE_BLUR)), MOVING
    still = kind_of == STILL
    if still.any():
        line = mask_outline(still, ((kind_of > 0) & ~still) | _grown(shown.changed & ~still) | outside)
        seen = edge_offsets(shown.grey, line, reach)
        yield line, _without_own(seen, rendered_edges(picture, kinds == STILL, line, 0.0)), STILL


def rendered_edges(picture: BodyPicture, bodies: NDArray[np.bool_], line: MaskOutline, blur: float) -> EdgeOffsets:
    """Return where the edges of rendered bodies (nbody,) are found along an outline, in a picture blurred by `blur` px.

    The blur moves the edges of curved and thin bodies, and an outline's points are on a grid of pixels. Both hold for
    the picture's edges too, so that the difference tells how far the bodies are from their places.
    """
    sigma = picture.step * math.hypot(blur, _PIXEL_BLUR)
    fine = np.where(bodies[picture.fine_bodies], _FULL, 0).astype(np.uint8)
    soft = cv2.GaussianBlur(fine, (0, 0), sigma)[:: picture.step, :: picture.step]
    return edge_offsets(np.ascontiguousarray(soft), line, _RENDERED_REACH, falling=True)


def _without_own(seen: EdgeOffsets, rendered: EdgeOffsets) -> EdgeOffsets:
    """Return the offsets of seen edges from rendered ones; NaN where one of both is not found."""
    return EdgeOffsets(seen.offsets - rendered.offsets, seen.search_distance)


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)


def _weighted(rows: Sequence[_FrameRows], size: int) -> Iterator[FrameEquations]:
    """Yield each picture's equations, with robust weights by the spread of residuals of each camera's bodies."""
    sigmas = _edge_sigmas(rows)
    for one in rows:
        sigma = np.array([sigmas[one.camera, body] for body in one.bodies.tolist()])
        weight = edge_weights(one.residuals, sigma, SHARED_ERRORS * sigma)
        # All pictures show the same edges of still bodies, with the same errors.
        weight[one.still] *= min(1.0, _STILL_PICTURES / sum(other.camera == one.camera for other in rows))
        weighted = one.jacobian * weight[:, None]
        median = float(np.median(np.abs(one.residuals))) if len(weight) else float("nan")
        yield FrameEquations(
            one.camera,
            one.frame,
            weighted.T @ one.jacobian,
            weighted.T @ one.residuals,
            one.points,
            len(one.residuals),
            median,
        )


def _edge_sigmas(rows: Sequence[_FrameRows]) -> dict[tuple[int, int], float]:
    """Return the standard deviation (px) of edges' positions by camera and body."""
    parts: dict[tuple[int, int], list[Array]] = {}
    grains = {one.camera: one.grain for one in rows}
    for one in rows:
        for body in np.unique(one.bodies).tolist():
            parts.setdefault((one.camera, body), []).append(one.residuals[one.bodies == body])
    return {key: edge_spread(np.concatenate(own), EDGE_SIGMA * grains[key[0]]) for key, own in parts.items()}


def lens_jacobian(pixels: Array, normals: Array, K: Array) -> tuple[Array, Array]:
    """Return how far (px) pixels (n, 2) move along normals with the logarithm of the focal length and with k1, (n,)."""
    from_middle = pixels - K[:2, 2]
    focal = (from_middle * normals).sum(axis=1)
    return focal, focal * ((from_middle / K[[0, 1], [0, 1]]) ** 2).sum(axis=1)


def start_state(
    rig: RigConfig, T_base_in_cam: Sequence[Array], log_focal: Sequence[float], bodies: int
) -> StationState:
    """Return the state before the fit: the rig's bases, no offsets and no delays."""
    cameras = len(T_base_in_cam)
    return StationState(
        tuple(T_base_in_cam),
        tuple(log_focal),
        (0.0,) * cameras,
        (0.0,) * cameras,
        (0.0,) * cameras,
        (np.zeros(_BIASES * bodies),) * cameras,
        tuple(np.zeros(arm.robot.dof) for arm in rig.arms),
        rig_bases(rig),
    )


def rig_bases(rig: RigConfig) -> tuple[Array, ...]:
    """Return the pose (4, 4) of each arm's base in the reference arm's base, by the rig."""
    to_reference = invert_pose(rig.T_base_in_world(rig.recording_order[0]))
    return tuple(to_reference @ rig.T_base_in_world(k) for k in range(len(rig.arms)))
