"""Every command line of README and docs, in the order of the pages in one folder, as a user would run them."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tests.cli.warm import WarmRun, warm_process
from tests.e2e.page_lines import prepared, reason_not_to_run, serves
from tests.mugs import has_import_extra, mug, write_mugs
from tests.objects.test_fits import block
from tests.pages import Block, blocks, shell_blocks, snippet
from tests.racks import rack_sdf
from tests.real.recordings.making import write_csv
from tests.rig_photos import CAMERA, JOINTS, RigPhotographer, looking
from tests.rig_scenes import later, plant, rig_scene, swings
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, load_lock

pytestmark = [pytest.mark.slow, pytest.mark.render]

# s; a longer line hangs, or serves and is missing in page_lines.SERVERS
LIMIT = 300
Process = WarmRun | subprocess.Popen[bytes]
EXTRAS = ("av", "gymnasium", "msgpack", "pyarrow", "reportlab", "rerun", "viser")


@dataclass(frozen=True)
class Shell:
    """A user's shell: its folder and environment."""

    folder: Path
    environ: dict[str, str]

    def start(self, line: str, log: Path) -> Process:
        """Start a line, with output to a file. Lines of yamsim alone run in forks, which start sooner."""
        with log.open("wb") as file:
            name, *words = shlex.split(line)
            if name == "yamsim" and ">" not in words:
                return warm_process().start(words, self.folder, self.environ, file, file)
            return subprocess.Popen(
                ["bash", "-c", f"exec {line}"],
                cwd=self.folder,
                env=self.environ,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )

    def run(self, line: str, log: Path) -> str | None:
        """Run a line to its end; return what is wrong, if anything."""
        process = self.start(line, log)
        try:
            code = process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            return f"has not ended after {LIMIT} s; if it serves until it is stopped, name it in page_lines.SERVERS"
        return None if code == 0 else f"ended with exit code {code}"

    @contextmanager
    def serving(self, line: str, log: Path, failures: list[str]) -> Iterator[None]:
        """Run a line that serves, from its printed URL on."""
        process = self.start(line, log)
        end = time.monotonic() + LIMIT
        while not (printed := re.search(r"http://127\.0\.0\.1:\d+", log.read_text())):
            if has_ended(process) or time.monotonic() > end:
                break
            time.sleep(0.1)
        try:
            yield
            if printed is None:
                failures.append(failure(line, "has printed no URL", log))
                return
            process.send_signal(signal.SIGINT)
            if code := process.wait(LIMIT):
                failures.append(failure(line, f"ended with exit code {code} after SIGINT", log))
        finally:
            process.kill()
            process.wait(10)


def has_ended(process: Process) -> bool:
    try:
        process.wait(0)
    except subprocess.TimeoutExpired:
        return False
    return True


@pytest.fixture
def shell(tmp_path: Path, repository: Path, locations: Locations) -> Shell:
    """A folder with the files that the pages' lines name, and `yamsim` on the path."""
    for extra in EXTRAS:
        pytest.importorskip(extra, reason="the pages' lines need the extras: make setup-dev")
    folder, programs, assets = (tmp_path / name for name in ("work", "bin", "assets"))
    folder.mkdir()
    programs.mkdir()
    (programs / "yamsim").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m yamsim_cli "$@"\n')
    (programs / "yamsim").chmod(0o755)
    # `assets import` writes into the user's store.
    if locations.assets.is_dir():
        shutil.copytree(locations.assets, assets)
    write_inputs(folder, locations)
    # A page instead of a window, and no width or colour, as for a pipe.
    environ = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY", "COLUMNS")}
    environ |= {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(repository),
        "YAMSIM_ASSETS": str(assets),
    }
    return Shell(folder, environ)


def write_inputs(folder: Path, locations: Locations) -> None:
    """Write a user's files: the text of the page if it has some, else files of the test."""
    (folder / "my_policy.py").write_text(snippet("python", "class MyPolicy"))
    (folder / "first_policy.py").write_text(snippet("python", "class FirstPolicy"))
    (folder / "only_lights.yaml").write_text(snippet("yaml", "only_lights.yaml"))
    (folder / "stream.jsonl").write_text(snippet("json", '"event": "start"'))
    (folder / "mug.stl").write_bytes(block((0.04, 0.04, 0.09)))
    (folder / "my_rack.sdf").write_text(rack_sdf())
    if has_import_extra():
        printed = write_mugs(folder, segments=24)
        (folder / "my_mug.glb").write_bytes(printed["glb"].read_bytes())
        scan = mug(24)
        scan.apply_scale(1000)
        scan.export(folder / "scan.obj")
    with RigPhotographer("russet", locations, CAMERA) as studio:
        shot = studio.shoot(looking((0.95, -0.12, 0.7), (0.08, 0.0, 0.1)), JOINTS)
    (folder / "morning").mkdir()
    for photo in ("photo.png", "morning/0001.png"):
        cv2.imwrite(str(folder / photo), shot.image[:, :, ::-1])
    # The left arm's come first.
    np.save(folder / "joints.npy", JOINTS[::-1].reshape(-1))
    camera = {
        "width": CAMERA.width,
        "height": CAMERA.height,
        "K": [list(row) for row in CAMERA.K],
        "distortion": list(CAMERA.distortion),
    }
    (folder / "camera.yaml").write_text(yaml.safe_dump(camera))
    times = np.arange(0, 4.0, 0.01)
    logged = later(plant(rig_scene(), times, [swings(times)]), 2)
    for log in ("log.csv", "monday.csv", "tuesday.csv"):
        write_csv(folder / log, logged, load_config(RigConfig, "rigs", "single", locations))


def failure(line: str, problem: str, log: Path) -> str:
    return f"$ {line}\n{problem}; it printed:\n{log.read_text()[-2000:]}"


def no_meshes(line: str, locations: Locations) -> str | None:
    """Return why a line that fetches or reads meshes is not run; None if it can run."""
    lock, store = load_lock(locations), AssetStore(locations.assets)
    if line.startswith(("yamsim assets fetch", "yamsim assets import 0")) and not all(
        store.find_verified_folder(assets) for assets in lock.sets.values()
    ):
        return "the meshes are not here, and this test uses no network"
    return None


def test_every_command_line_of_the_pages_works(shell: Shell, locations: Locations) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        policy_port = probe.getsockname()[1]
    failures: list[str] = []
    for k, lines in enumerate(once_each(shell_blocks())):
        run_block(shell, lines, policy_port, shell.folder.parent / f"block{k}", failures, locations)
    for code in (part.text for part in blocks() if part.language == "python" and '"labelled' in part.text):
        (shell.folder / "snippet.py").write_text(code)
        log = shell.folder.parent / "snippet.log"
        if problem := shell.run(f"{sys.executable} snippet.py", log):
            failures.append(failure(code, problem, log))
    assert not failures, "\n\n".join(failures)


def once_each(shown: list[Block]) -> Iterator[Block]:
    """Omit lines that an earlier page shows too: their outputs exist already."""
    seen: set[str] = set()
    for lines in shown:
        new = [line for line in lines.commands if line not in seen]
        seen.update(new)
        yield replace(lines, text="\n".join(new))


def no_extra(line: str) -> str | None:
    """Return why a line that reads an object file cannot run here."""
    reads = any(name in line for name in ("my_mug.glb", "scan.obj"))
    return "the extra for import is not installed" if reads and not has_import_extra() else None


def run_block(
    shell: Shell, lines: Block, policy_port: int, logs: Path, failures: list[str], locations: Locations
) -> None:
    with ExitStack() as servers:
        for k, shown in enumerate(lines.commands):
            reason = reason_not_to_run(shown) or no_meshes(shown, locations) or no_extra(shown)
            if reason:
                print(f"not run: {shown}: {reason}")
                continue
            line, log = prepared(shown, policy_port), Path(f"{logs}_{k}.log")
            began = time.monotonic()
            if serves(line):
                servers.enter_context(shell.serving(line, log, failures))
            elif problem := shell.run(line, log):
                failures.append(f"{lines.section}: {failure(line, problem, log)}")
            print(f"{time.monotonic() - began:6.1f} s  {line}")
