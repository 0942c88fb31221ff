from __future__ import annotations

import errno
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from yamsim_cli import doctor
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.doctor import Health, HealthCheck, failed_checks, run_health_checks
from yamsim_cli.filesystem_mounts import Mount
from yamsim_cli.gl import GlBackend

SOFTWARE = GlBackend("egl", "llvmpipe (LLVM 19)")
GPU = GlBackend("egl", "NVIDIA H200/PCIe")

Look = Callable[..., dict[str, HealthCheck]]


@pytest.fixture
def look(locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Look:
    """Check a machine with fictitious backends and GPU."""

    def examine_it(
        backends: Mapping[str, GlBackend | str] | None = None,
        environ: Mapping[str, str] | None = None,
        gpu: bool = False,
        out: Path | None = None,
    ) -> dict[str, HealthCheck]:
        found = backends or {"egl": SOFTWARE, "osmesa": "no library"}
        monkeypatch.setattr(doctor, "probe_backend", lambda name, environ: found[name])
        monkeypatch.setattr(doctor, "require_filament", lambda: "a GPU")
        monkeypatch.setattr(doctor, "GPUS", (str(tmp_path),) if gpu else ())
        where = replace(locations, assets=tmp_path / "assets")
        return {check.name: check for check in run_health_checks(environ or {}, where, out or tmp_path / "dataset")}

    return examine_it


def test_every_check_is_told_as_it_ends(locations: Locations, tmp_path: Path, look: Look) -> None:
    names = list(look())
    told: list[HealthCheck] = []
    checks = run_health_checks({}, locations, tmp_path, told.append)
    assert told == checks
    assert [check.name for check in checks] == names
    for part in ("packages", "extra.video", "gl.egl", "gl.osmesa", "gl", "photo", "meshes.ycb", "disk", "workers"):
        assert part in names


def test_one_backend_that_works_is_enough(look: Look) -> None:
    checks = look()
    assert checks["gl.egl"].health is checks["gl.osmesa"].health is checks["gl"].health is Health.OK
    assert checks["gl"].detail == "MUJOCO_GL=egl will be used; --quality auto is balanced"
    assert look({"egl": GPU, "osmesa": "no"}, gpu=True)["gl"].detail.endswith("--quality auto is high")


def test_no_backend_is_a_fault_with_its_fix(look: Look) -> None:
    check = look({"egl": "hangs (gave up after 60 s)", "osmesa": "no library"})["gl"]
    assert check.health is Health.FAULT
    assert "apt-get install" in check.fix


def test_a_choice_that_does_not_work_is_a_fault_though_others_do(look: Look) -> None:
    checks = look({"glfw": "no display", "egl": SOFTWARE, "osmesa": "no"}, {"MUJOCO_GL": "glfw"})
    assert (checks["gl"].health, checks["gl"].fix) == (Health.FAULT, "unset MUJOCO_GL")


def test_a_gpu_that_is_not_used_is_a_warning(look: Look) -> None:
    check = look(gpu=True)["gl"]
    assert check.health is Health.WARNING
    assert "llvmpipe" in check.detail
    assert "libnvidia-gl" in check.fix


def test_meshes_that_are_not_here_are_a_warning_and_changed_ones_a_fault(look: Look, tmp_path: Path) -> None:
    check = look()["meshes.ycb"]
    assert (check.health, check.fix) == (Health.WARNING, "yamsim assets fetch")
    (tmp_path / "assets/ycb").mkdir(parents=True)
    (tmp_path / "assets/ycb/011_banana.stl").write_bytes(b"no banana")
    check = look()["meshes.ycb"]
    assert check.health is Health.FAULT
    assert "011_banana.stl" in check.detail


def test_the_disk_is_written_to_and_left_as_it_was(look: Look, tmp_path: Path) -> None:
    out = tmp_path / "disk" / "dataset"
    out.parent.mkdir()
    check = look(out=out)["disk"]
    assert check.figures["episode_s"] > 0
    assert check.figures["free_bytes"] > 0
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize(("name", "told"), [("file", "it is a file"), ("x" * 300, "it is too long")])
def test_a_place_where_no_dataset_can_be_is_a_fault(look: Look, tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "file").touch()
    check = look(out=tmp_path / name)["disk"]
    assert (check.health, check.fix) == (Health.FAULT, "choose another --out")
    assert f"{name}: {told}" in check.detail


def test_a_disk_that_refuses_is_a_fault(look: Look, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(doctor, "publish_directory", refuse)
    check = look()["disk"]
    assert check.health is Health.FAULT
    assert "No space left on device" in check.detail


def test_a_network_mount_is_not_touched(look: Look, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mount = Mount(1, 0, doctor.Path("/mnt"), "fuse.sshfs", "host:/data", frozenset())  # type: ignore[arg-type]
    monkeypatch.setattr(doctor, "network_mount", lambda path, mounts: mount)
    monkeypatch.setattr(doctor, "write_episodes", lambda place: pytest.fail("touched"))
    check = look()["disk"]
    assert check.health is Health.WARNING
    assert "fuse.sshfs" in check.detail
    assert "--stage" in check.fix


@pytest.mark.parametrize(
    ("memory", "workers", "health"),
    [(None, 8, "ok"), (20e9, 8, "ok"), (1.1e9, 3, "warning"), (0.2e9, 1, "fault")],
)
def test_as_many_workers_as_cores_and_memory_allow(
    look: Look, monkeypatch: pytest.MonkeyPatch, memory: float | None, workers: int, health: str
) -> None:
    monkeypatch.setattr(doctor, "usable_cores", lambda: 8)
    monkeypatch.setattr(doctor, "usable_memory", lambda: memory and int(memory))
    check = look()["workers"]
    assert (check.figures["workers"], check.health) == (workers, health)


@pytest.mark.parametrize(
    ("memory", "told"),
    [
        (None, "yamsim record --quality photo --workers 8: 1.8 GB for each worker with one renderer"),
        (20e9, "yamsim record --quality photo --workers 8: 1.8 GB for each worker with one renderer"),
        (4e9, "yamsim record --quality photo --workers 2, limited by memory: 1.8 GB for each worker with one renderer"),
        (1.1e9, "--quality photo may need more memory than is free: 1.8 GB for each worker with one renderer"),
    ],
)
def test_workers_for_photo_count_the_memory_of_filament(
    look: Look, monkeypatch: pytest.MonkeyPatch, memory: float | None, told: str
) -> None:
    monkeypatch.setattr(doctor, "usable_cores", lambda: 8)
    monkeypatch.setattr(doctor, "usable_memory", lambda: memory and int(memory))
    check = look()["workers.photo"]
    assert (check.detail, check.health) == (told, Health.OK)
    assert "workers.photo" not in look({"egl": "no library", "osmesa": "no library"})


def test_every_extra_is_checked(repository: Path) -> None:
    project = tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert doctor.EXTRAS.keys() == project["optional-dependencies"].keys()


def test_a_package_that_is_missing_is_a_fault(look: Look, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PACKAGES", (*doctor.PACKAGES, "no-such-package"))
    monkeypatch.setattr(doctor, "EXTRAS", {"video": ("no-such-package", "MP4")})
    checks = look()
    assert (checks["packages"].health, checks["extra.video"].health) == (Health.FAULT, Health.OK)
    assert checks["extra.video"].fix == "pip install 'yamsim[video]'"
    assert [check.name for check in failed_checks(list(checks.values()))] == ["packages"]
