import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from yamsim_cli import gl
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.gl import GlBackend, find_backend


class FakeSubprocess:
    """Replaces `subprocess.run`: backend -> exit code and stderr, or an exception; records its calls."""

    def __init__(self, answers):
        self.answers = answers
        self.environments = []

    def __call__(self, command, *, env, timeout, **options):
        assert command[0] == sys.executable
        assert timeout > 0
        self.environments.append(env)
        answer = self.answers[env["MUJOCO_GL"]]
        if isinstance(answer, Exception):
            raise answer
        code, stderr = answer
        return SimpleNamespace(returncode=code, stderr=stderr, stdout="" if code else "noise\nllvmpipe (LLVM 15)\n")

    @property
    def tried(self):
        return [environment["MUJOCO_GL"] for environment in self.environments]


@pytest.fixture
def probing(monkeypatch):
    def prepare(**answers) -> FakeSubprocess:
        probes = FakeSubprocess(answers)
        monkeypatch.setattr(gl.subprocess, "run", probes)
        return probes

    return prepare


GOOD = (0, "")
BAD = (1, "Traceback\n  File x\nImportError: no libEGL\n")


@pytest.mark.parametrize(
    ("answers", "environ", "platform", "tried"),
    [
        ({"egl": GOOD}, {}, "linux", ["egl"]),
        ({"egl": BAD, "osmesa": GOOD}, {}, "linux", ["egl", "osmesa"]),
        ({"egl": GOOD}, {"MUJOCO_GL": ""}, "linux", ["egl"]),
        ({"osmesa": GOOD}, {"MUJOCO_GL": "osmesa"}, "linux", ["osmesa"]),
        ({"osmesa": GOOD}, {"MUJOCO_GL": "osmesa"}, "darwin", ["osmesa"]),
    ],
    ids=["GPU first", "software second", "empty choice", "user's choice on Linux", "user's choice elsewhere"],
)
def test_the_first_backend_that_works_is_chosen(probing, answers, environ, platform, tried):
    probes = probing(**answers)
    assert find_backend(environ, platform) == GlBackend(tried[-1], "llvmpipe (LLVM 15)")
    assert probes.tried == tried


def test_a_bad_choice_of_the_users_is_not_replaced_by_another(probing):
    probes = probing(osmesa=BAD, egl=GOOD)
    with pytest.raises(ResourceError, match=r"osmesa: ImportError: no libEGL.*MUJOCO_GL is set.*unset it"):
        find_backend({"MUJOCO_GL": "osmesa"}, "linux")
    assert probes.tried == ["osmesa"]


def test_when_nothing_works_one_line_says_why_and_what_to_install(probing):
    probing(egl=BAD, osmesa=(1, "AttributeError: 'NoneType' object has no attribute 'glGetError'\n\n"))
    with pytest.raises(ResourceError) as caught:
        find_backend({}, "linux")
    message = str(caught.value)
    assert "egl: ImportError: no libEGL" in message
    assert "osmesa: AttributeError: 'NoneType' object has no attribute 'glGetError'" in message
    assert "apt-get install libegl1" in message
    assert "MUJOCO_GL is set" not in message
    assert "\n" not in message


def test_a_hang_is_a_reason_and_not_the_end(probing):
    hang = subprocess.TimeoutExpired("python", 60)
    probing(egl=hang, osmesa=GOOD)
    assert find_backend({}, "linux").name == "osmesa"
    probing(egl=hang, osmesa=BAD)
    with pytest.raises(ResourceError, match="egl: hangs"):
        find_backend({}, "linux")


def test_a_crash_without_a_word_gives_its_exit_code(probing):
    probing(egl=(-11, "\n \n"), osmesa=BAD)
    with pytest.raises(ResourceError, match=r"egl: crashes \(exit code -11\)"):
        find_backend({}, "linux")


def test_elsewhere_mujoco_chooses_and_nothing_is_tried(probing):
    probes = probing()
    assert find_backend({}, "darwin").name is None
    assert probes.tried == []


def test_a_probe_keeps_the_environment_but_for_pyopengls_own_choice(probing):
    probes = probing(egl=GOOD)
    given = {"PATH": "/bin", "PYOPENGL_PLATFORM": "osmesa"}
    find_backend(given, "linux")
    assert probes.environments == [{"PATH": "/bin", "MUJOCO_GL": "egl"}]
    assert given == {"PATH": "/bin", "PYOPENGL_PLATFORM": "osmesa"}


@pytest.mark.parametrize(
    ("probe", "reason"),
    [
        ("import time; time.sleep(60)", "hangs"),
        (r"import os; os.write(2, b'driver \xff\xfe\n'); raise SystemExit(3)", "driver \ufffd\ufffd"),
        ("import os; os.kill(os.getpid(), 11)", r"crashes \(exit code -11\)"),
        ("import os; assert os.environ['MUJOCO_GL'] != 'mine', 'seen'", "AssertionError: seen"),
    ],
)
def test_a_real_probe_that_hangs_crashes_or_prints_junk_costs_a_message_only(monkeypatch, probe, reason):
    monkeypatch.setattr(gl, "PROBE_PROGRAM", probe)
    monkeypatch.setattr(gl, "PROBE_SECONDS", 0.5 if "sleep" in probe else 60.0)
    with pytest.raises(ResourceError, match=f"mine: {reason}"):
        find_backend({"MUJOCO_GL": "mine"}, "linux")


@pytest.mark.parametrize(
    ("renderer", "software"),
    [
        ("llvmpipe (LLVM 15.0.6, 256 bits)", True),
        ("softpipe", True),
        ("Software Rasterizer", True),
        ("Google SwiftShader", True),
        ("NVIDIA H200/PCIe/SSE2", False),
        ("Mesa Intel(R) UHD Graphics 620 (KBL GT2)", False),
        ("Apple M2", False),
        ("", False),
    ],
)
def test_software_is_told_by_what_opengl_calls_itself(renderer, software):
    assert GlBackend("egl", renderer).is_software is software


@pytest.mark.render
def test_a_real_probe_tells_what_draws():
    assert find_backend(os.environ, "linux").renderer
