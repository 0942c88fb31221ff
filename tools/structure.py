"""Counts lines, files and public class names of the package, and the modules that run for one episode and one photo.

MUJOCO_GL=egl python -m tools.structure
"""

from __future__ import annotations

import ast
import contextlib
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from tools.bench.setting import setting, use_gl

PACKAGE = Path(__file__).resolve().parents[1] / "yamsim_cli"


def main() -> None:
    """Print the counts and the modules."""
    use_gl()
    files = sorted(PACKAGE.rglob("*.py"))
    lines = {path: path.read_text(encoding="utf-8").count("\n") for path in files}
    core = [path for path in files if path.is_relative_to(PACKAGE / "core")]
    classes = Counter(
        node.name
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    print(
        f"{sum(lines.values())} lines in {sum(map(bool, lines.values()))} files; {sum(lines[p] for p in core)} in core"
    )
    print(f"{sum(path.is_dir() for path in (PACKAGE / 'core').iterdir() if path.name[0] != '_')} packages in core")
    print(f"public class names that exist twice: {sorted(name for name, count in classes.items() if count > 1)}")
    for what, prepare in (("episode", _episode), ("photo", _photo)):
        found = modules_that_run(prepare())
        print(f"{len(found)} modules run for one {what}:\n  " + "\n  ".join(found))


def modules_that_run(work: Callable[[], object]) -> list[str]:
    """Return the modules of the package of which a function runs during `work`, sorted."""
    found = set[str]()

    def see(frame: FrameType, event: str, argument: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and frame.f_code.co_name != "<module>" and path.is_relative_to(PACKAGE):
            found.add(str(path.relative_to(PACKAGE)))

    sys.setprofile(see)
    try:
        work()
    finally:
        sys.setprofile(None)
    return sorted(found)


def _episode() -> Callable[[], object]:
    """Return the work for one recorded episode of `pickplace` in a process that has recorded another."""
    from yamsim_cli.core.attempt_data import AttemptJob
    from yamsim_cli.core.dataset.records import attempt_record, episode_record
    from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
    from yamsim_cli.core.dataset.writing.writer import DatasetWriter
    from yamsim_cli.core.episode.runner import AttemptRunner

    session = setting("fast")
    runner = AttemptRunner(session, render=True)
    writer = DatasetWriter(Path(tempfile.mkdtemp()) / "dataset", session.config.data_config(), ExistingDatasetMode.NEW)

    def record(number: int) -> None:
        payload = runner.run(AttemptJob(0, number))
        writer.publish_episode(episode_record(session.config, payload, number), payload.files)
        writer.log_attempt(attempt_record(payload, number))

    record(0)
    return lambda: record(1)


def _photo() -> Callable[[], object]:
    """Return the work of `overlay` for one photo of a rig with two boards, after another in the same process."""
    import cv2

    from tests.rig_photos import JOINTS, RigPhotographer, looking
    from tests.truth_photos import CAMERA
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.main import main as command_line

    folder, locations = Path(tempfile.mkdtemp()), Locations.from_environment(os.environ)
    with RigPhotographer(load_config(RigConfig, "rigs", "russet", locations), locations, CAMERA) as photographer:
        photo = photographer.shoot(looking((-0.5, 0.3, 0.7), (0.2, -0.3, 0.1)), JOINTS)
    cv2.imwrite(str(folder / "photo.png"), photo.image[..., ::-1])

    def overlay() -> None:
        sys.argv = [
            "yamsim",
            "overlay",
            "--img",
            str(folder),
            "--rig",
            "russet",
            "--out",
            str(folder / "out"),
            "--overwrite",
        ]
        with contextlib.suppress(SystemExit):
            command_line()

    overlay()
    return overlay


if __name__ == "__main__":
    main()
