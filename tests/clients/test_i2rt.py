"""The maker's own SDK, unmodified, on simulated motors; and portal's own client."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.clients.environments import Interpreter
from tests.clients.served_robot import served_robot

pytestmark = pytest.mark.client


def test_the_sdk_calibrates_moves_holds_and_floats(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("i2rt")
    with served_robot(tmp_path / "buses") as served:
        told = served.run(interpreter, "i2rt_arm.py", "can0", 3, 5)
    closed, opened = told["gripper_limits"]
    assert closed == pytest.approx(0.0, abs=0.1)
    assert opened == pytest.approx(-6.5, abs=0.3)
    assert told["hold"]["off_rad"] < 0.02
    assert told["drift_rad"] < 0.02
    assert told["closed"] == pytest.approx(0.0, abs=0.05)
    assert all(20 <= celsius < 60 for celsius in told["temperature"])


def test_two_arms_at_once(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("i2rt")
    with served_robot(tmp_path / "buses", "--rig", "yam_station_linear_4310_d405") as served:
        for side in ("left", "right"):
            assert served.run(interpreter, "i2rt_arm.py", f"can_{side}", 0.5, 0.5)["hold"]["off_rad"] < 0.02
    assert served.report["channels"] == ["can_left", "can_right"]


def test_the_sdks_tools_find_motors_registers_and_faults(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("i2rt")
    tool = ("-m", "i2rt.motor_config_tool.dm_motor_registers")
    with served_robot(tmp_path / "buses", "--fault", "lost:motor=3") as served:
        ping = served.call(interpreter, "-m", "i2rt.motor_config_tool.ping_motors", "--channel", "can0")
        assert "online motors: [1, 2, 4, 5, 6, 7]" in ping.stdout
        table = served.call(interpreter, *tool, "read-all", "--motor-id", "2")
        assert table.returncode == 0 and "ERR" not in table.stdout
        assert " 20  Gr         float   ro      40" in table.stdout
        once = served.call(interpreter, "-m", "i2rt.motor_config_tool.set_timeout", "--motor_id", "2")
        assert "timeout = 8000" in once.stdout and "timeout = 0" in once.stdout
        # It refuses to start an arm that lacks a motor, and names the motor.
        arm = served.call(interpreter, "-m", "i2rt.robots.motor_chain_robot", timeout_s=60)
        assert arm.returncode and "motor 3 (DM4340)" in arm.stderr


@pytest.mark.parametrize(
    ("fault", "seconds", "running", "says"),
    [
        pytest.param("hot:motor=2,at=15", 40, False, "motor id: 2, error: motor over temperature", id="hot"),
        pytest.param("lost:motor=5,at=15", 40, False, "fail to communicate with the motor 5", id="lost"),
        pytest.param("drop:share=0.01", 5, True, "", id="dropped"),
    ],
)
def test_the_sdk_meets_faults(
    client: Callable[[str], Interpreter], tmp_path: Path, fault: str, seconds: float, running: bool, says: str
) -> None:
    """It stops at a failing motor and names it; it asks for lost frames again."""
    interpreter = client("i2rt")
    with served_robot(tmp_path / "buses", "--fault", fault) as served:
        told = served.run(interpreter, "i2rt_faults.py", "can0", seconds)
    assert told["running"] is running
    assert says in told["said"]
    assert (served.report["dropped"] > 0) is running


def test_portals_client_drives_the_arm(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("portal")
    with served_robot(tmp_path / "buses", "--portal", "0") as served:
        told = interpreter.run("portal_arm.py", served.ports[0], 100)
    assert told["dofs"] == 7
    assert told["pos"] == pytest.approx([0.3, 1.2, 1.2, -0.2, 0.1, 0.2, 1.0], abs=0.02)
    sizes = {"joint": 6, "gripper": 1}
    assert told["observations"] == {f"{part}_{key}": n for part, n in sizes.items() for key in ("pos", "vel", "eff")}
    assert "not finite" in told["refused"]
    assert told["closed"] == pytest.approx(0.0, abs=0.02)
