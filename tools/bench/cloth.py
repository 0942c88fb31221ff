"""Measure cloth: folds by a task's expert, or drops and pulls of a single cloth.

python -m tools.bench.cloth --fold fold_napkin --n 25
python -m tools.bench.cloth --shake soft_napkin --n 60
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

os.environ.setdefault("MUJOCO_GL", "off")

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import ActionSequence, AttemptJob, StepState
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.episode.episode_rules import REPLAY_RULES
from yamsim_cli.core.episode.execution import simulate_actions, simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.cloth_contacts import count_self_intersections
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.cloth import add_cloth, flat_points, grid_edges, grid_triangles
from yamsim_cli.core.sim.cloth import ClothGraspConstraints
from yamsim_cli.session_opener import SessionOpener

# Steps of a drop or pull, their length (s), and the step that releases the pulled point.
_STEPS, _STEP, _LET_GO = 300, 0.004, 225
# m/s; faster points are no motion of cloth
_TOO_FAST = 20.0
# m, opening of each finger that holds nothing
_OPEN = 0.02


@dataclass
class Sheet:
    """Largest stretch of a cloth, and largest number of its edges that pass through its triangles."""

    grid: tuple[int, int]
    rest: Array
    stretch: float = 0.0
    crossings: int = 0
    seconds: float = field(default=0.0)

    def see(self, points: Array) -> None:
        """Measure the points (n, 3)."""
        began = time.process_time()
        ends = grid_edges(*self.grid)
        lengths = [np.linalg.norm(at[ends[:, 0]] - at[ends[:, 1]], axis=1) for at in (points, self.rest)]
        self.stretch = max(self.stretch, float((lengths[0] / lengths[1]).max()) - 1)
        self.crossings = max(self.crossings, count_self_intersections(points, ends, grid_triangles(*self.grid)))
        self.seconds += time.process_time() - began


class _Watching:
    """Measures the cloths of all simulations, every fourth control tick."""

    def __init__(self) -> None:
        self.sheets: dict[str, Sheet] = {}
        self._ticks, update = 0, ClothGraspConstraints.update_grasps

        def seen(grips: ClothGraspConstraints, data: mujoco.MjData, ctrl: Array) -> list[bool]:
            self._ticks += 1
            if self._ticks % 4 == 0:
                for name, cloth in grips._scene.cloths.items():
                    sheet = self.sheets.setdefault(name, Sheet(cloth.grid, cloth.flat_points))
                    sheet.see(cloth.points(data.qpos))
            return update(grips, data, ctrl)

        ClothGraspConstraints.update_grasps = seen  # type: ignore[assignment, method-assign]


def fold(task: str, count: int, first: int, spoilt: int) -> None:
    """Attempts of a task's expert; the first ones also without closing fingers, and released half-way."""
    watching = _Watching()
    opener = SessionOpener(os.environ, lambda text: None, str)
    with SimulatorCache(opener.open("default", renders=False, task=task)) as simulators:
        for number in range(first, first + count):
            watching.sheets.clear()
            job, began = AttemptJob(0, number), time.process_time()
            simulator = simulators.get(job)
            done = simulate_expert(simulator, sample_attempt(simulator, job))
            took = time.process_time() - began - sum(sheet.seconds for sheet in watching.sheets.values())
            outcome, sheets = done.outcome, list(watching.sheets.values())
            print(
                f"{number}: {outcome.cause or 'folded'}; {'; '.join(m.detail for m in outcome.measures if m.detail)}; "
                f"stretch {max(s.stretch for s in sheets):.1%}, {max(s.crossings for s in sheets)} edges through "
                f"triangles; {took:.1f} s for {len(done.recorded_states) * 0.064:.1f} s; "
                f"{len(outcome.recoveries)} recoveries",
                flush=True,
            )
            if number - first < spoilt and outcome.success:
                stuck = simulate_expert(simulator, done.attempt, grips=False).outcome
                print(f"   the expert's fingers do not close: {stuck.cause or 'folded'}", flush=True)
                for what, share in (("the same motion, fingers open", 0.0), ("let go half-way", 0.5)):
                    opened = _opened(simulator, done.recorded_states, share)
                    spoilt_one = simulate_actions(simulator, done.attempt, opened, REPLAY_RULES).outcome
                    said = "; ".join(measure.detail for measure in spoilt_one.measures if measure.detail)
                    print(f"   {what}: {spoilt_one.cause or 'folded'}, {said}", flush=True)


def _opened(simulator: Simulator, states: Sequence[StepState], share: float) -> ActionSequence:
    """An episode's actions, with fingers that open after `share` of the hold; 0 never closes them."""
    acting = ActionSequence(
        *(np.concatenate([getattr(s.actions, key) for s in states]) for key in ("ctrl", "magnet", "joints"))
    )
    held, ctrl = np.flatnonzero(acting.magnet.any(axis=1)), acting.ctrl.copy()
    since = held[0] + int(share * (held[-1] - held[0])) if share else 0
    for arm in simulator.scene.arms:
        assert arm.fingers is not None
        ctrl[since:, arm.fingers.ctrl] = _OPEN
    return replace(acting, ctrl=ctrl)


def shake(name: str, count: int) -> None:
    """A cloth over a table, dropped in a random orientation, or pulled at a point in three directions and released."""
    item = load_config(ObjectConfig, "objects", name, Locations.from_environment(os.environ))
    assert item.cloth is not None, "give a cloth"
    spec, rest = mujoco.MjSpec(), flat_points(item.cloth)
    spec.option.timestep, spec.option.integrator = _STEP, mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.05], pos=[0, 0, -0.05], condim=4)
    add_cloth(spec, item)
    spec.worldbody.add_body(name="hand", mocap=True)
    for k in range(len(rest)):
        pull = spec.add_equality(type=mujoco.mjtEq.mjEQ_CONNECT, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False)
        pull.name1, pull.name2, pull.solref = f"{name}_{k}", "hand", [0.01, 1]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.set_mju_user_warning(lambda text: None)
    unstable, sheets, began = 0, [], time.process_time()
    for number in range(count):
        sheet = Sheet(item.cloth.grid, rest)
        unstable += not _shaken(
            model, data, sheet, item.cloth.half_thickness, np.random.default_rng(number), bool(number % 2)
        )
        sheets.append(sheet)
    took = time.process_time() - began - sum(sheet.seconds for sheet in sheets)
    drops, pulls = (max(sheet.stretch for sheet in sheets[k::2]) for k in (0, 1))
    print(
        f"{name}: {unstable} of {count} unstable; stretch at most {drops:.1%} dropped, {pulls:.1%} pulled; "
        f"{sum(sheet.crossings > 0 for sheet in sheets)} end with edges through triangles; "
        f"{count * _STEPS * _STEP / took:.2f} x real time"
    )


def _shaken(
    model: mujoco.MjModel, data: mujoco.MjData, sheet: Sheet, radius: float, rng: np.random.Generator, pulled: bool
) -> bool:
    """Whether physics stayed stable."""
    mujoco.mj_resetData(model, data)
    turn, R = rng.normal(size=4), np.empty(9)
    mujoco.mju_quat2Mat(R, np.array([1.0, 0, 0, 0]) if pulled else turn / np.linalg.norm(turn))
    points = sheet.rest @ R.reshape(3, 3).T
    points[:, 2] += radius - points[:, 2].min() + (0.002 if pulled else rng.uniform(0.02, 0.3))
    data.qpos[:] = (points - sheet.rest).ravel()
    ways, fastest = rng.normal(size=(3, 3)), 0.0
    ways[:, 2] = np.abs(ways[:, 2]) * (1, 1, -1)
    ways *= (rng.uniform(0.2, 1.0, 3) / np.linalg.norm(ways, axis=1))[:, None]
    if pulled:
        point = int(rng.integers(len(points)))
        model.eq_data[point, :6], data.mocap_pos[0], data.eq_active[point] = 0.0, points[point], True
    for step in range(_STEPS):
        if pulled and step == _LET_GO:
            data.eq_active[:] = False
        data.mocap_pos[0] += ways[min(step * 3 // _LET_GO, 2)] * _STEP
        data.mocap_pos[0, 2] = max(data.mocap_pos[0, 2], radius)
        mujoco.mj_step(model, data)
        fastest = max(fastest, float(np.abs(data.qvel).max()))
        if step % 10 == 0:
            ends, at = grid_edges(*sheet.grid), sheet.rest + data.qpos.reshape(-1, 3)
            lengths = [np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1) for x in (at, sheet.rest)]
            sheet.stretch = max(sheet.stretch, float((lengths[0] / lengths[1]).max()) - 1)
    sheet.see(sheet.rest + data.qpos.reshape(-1, 3))
    warned = any(int(warning.number) for warning in data.warning)
    return not warned and bool(np.isfinite(data.qpos).all()) and fastest < _TOO_FAST


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fold", help="a task")
    parser.add_argument("--shake", help="a cloth")
    parser.add_argument("--n", type=int, default=25)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--spoilt", type=int, default=4)
    given = parser.parse_args()
    if given.fold:
        fold(given.fold, given.n, given.first, given.spoilt)
    if given.shake:
        shake(given.shake, given.n)
