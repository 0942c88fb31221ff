from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.session_options import session_opener, session_settings
from yamsim_cli.real.serve.socket_servers import default_socket_folder
from yamsim_cli.terminal.console import print_json, print_line, print_note
from yamsim_cli.terminal.signals import stop_on_signal

if TYPE_CHECKING:
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.real.motors.motor_bus import BusFault
    from yamsim_cli.real.serve.can_bus import KernelBus, UnixBus
    from yamsim_cli.real.serve.policy_robot import PolicyRobot
    from yamsim_cli.real.serve.realtime_loop import PolledServer
    from yamsim_cli.real.serve.render_process import RenderProcess
    from yamsim_cli.real.serve.served_arms import ServedArms

# us, time between the answers of two motors: two frames of 130 bits at 1 Mbit/s, and the USB adapter's delay. Seven
# motors then take 4 ms, the control period of the manufacturer's SDK (250 Hz).
_MOTOR_ANSWER_INTERVAL_US = 571.0

Folder = Annotated[
    Path | None,
    typer.Option(metavar="DIRECTORY", help="Folder of the buses' sockets.  [default: a folder of your user]"),
]


def serve_robot(
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    robot: flags.Robot = None,
    task: flags.Task = None,
    item: flags.Object = None,
    target: flags.Target = None,
    seed: flags.Seed = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(help="Name of an arm's bus, the left one's first.  [default: can0, or can_left and can_right]"),
    ] = None,
    start: Annotated[
        str, typer.Option(metavar="rest|home|task", help="Pose of the arms at the start, without power.")
    ] = "rest",
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAULT",
            help="Simulated fault: lost:motor=3,at=5,for=2; hot:motor=2; drop:share=0.1; stuck; or silent:camera=top.",
        ),
    ] = None,
    gap: Annotated[
        float,
        typer.Option("--answer-gap", metavar="US", min=0, max=100_000, help="Time between two answers of motors, us."),
    ] = _MOTOR_ANSWER_INTERVAL_US,
    kernel: Annotated[
        bool, typer.Option("--kernel", help="Use the kernel's CAN interfaces, such as vcan, instead of sockets.")
    ] = False,
    folder: Folder = None,
    portal: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65534,
            help="Also answer portal's calls on this port, such as 11333; for the second arm on the next port.",
        ),
    ] = None,
    chiral: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Also serve raiden's policies on this port, such as 8765."),
    ] = None,
    leader: Annotated[
        Path | None,
        typer.Option(
            metavar="EPISODE",
            help="Also simulate passive leader arms (GELLO) on can_lead_l and can_lead_r, which perform this episode.",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address of --portal and --chiral. Beyond 127.0.0.1, anyone who reaches it drives the arm."),
    ] = "127.0.0.1",
    cameras: Annotated[
        bool, typer.Option("--cameras", help="Also serve pictures to the camera readers of LeRobot and raiden.")
    ] = False,
    size: flags.Size = None,
    quality: flags.Quality = None,
    camera_fps: Annotated[
        float, typer.Option(min=0.1, max=120, help="Largest number of pictures a second of each camera.")
    ] = 30.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, max=1e6, help="Seconds after which the command ends.")
    ] = None,
    config: flags.ConfigOption = "default",
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Simulate arms in real time, with motors on CAN buses for the manufacturer's SDK. Ctrl-C ends the simulation.

    Example: yamsim serve-robot --rig yam_v1+linear_4310
    """
    from yamsim_cli.real.motors.motor_bus import parse_fault

    faults = [parse_fault(text) for text in fault or ()]
    rig = rig or "yam_v1+linear_4310"
    settings = session_settings(locals())
    session = session_opener.open(config, renders=cameras or chiral is not None, parallel=False, **settings)

    from yamsim_cli.real.serve.realtime_loop import RealtimeLoop
    from yamsim_cli.real.serve.served_arms import VALID_START_POSTURES, make_policy_robot, serve_arms

    if not cameras and any(one.camera for one in faults):
        raise UsageError("--fault silent: no camera is served; give --cameras")
    if start not in VALID_START_POSTURES:
        raise UsageError(f"--start {start!r} is not valid; valid: {', '.join(VALID_START_POSTURES)}")
    served = serve_arms(session, channel or (), faults, start)
    with ExitStack() as stack, stop_on_signal("Ending.") as stop:
        where = _bus_folder(folder)
        sockets = _open_bus_sockets(stack, served, None if kernel else where)
        ports = _open_portals(stack, served, host, portal)
        if leader is not None:
            ports.append(_open_leaders(stack, session, served, leader, None if kernel else where))
        policy_robot = None
        if cameras or chiral is not None:
            source = _start_render_process(stack, session, served, camera_fps)
            ports.append(source)
            if cameras:
                ports.append(_camera_server(stack, where, source, faults))
            if chiral is not None:
                policy_robot = make_policy_robot(session, served, source)
                ports.append(_open_chiral_server(stack, policy_robot, host, chiral))
        print_note("Ctrl-C ends" if kernel else "start programs with `yamsim can-run -- PROGRAM`; Ctrl-C ends")
        sys.stderr.flush()

        def drive() -> None:
            if policy_robot is not None:
                policy_robot.command_next_step()
            for follower in served.followers:
                follower.command_motors()

        loop = RealtimeLoop(served.motor_simulation, sockets, gap * 1e-6, ports, drive)
        loop.run(lambda: stop.is_requested, float("inf") if seconds is None else seconds)
        pace = loop.timing_stats
    if json:
        print_json({"channels": [bus.channel for bus in served.motor_simulation.buses], **asdict(pace)})
        return
    print_line(
        f"{pace.steps} physics steps in {pace.seconds:.1f} s, at most {pace.late_ms:.2f} ms late; {pace.late_steps} "
        f"steps more than one step late; {pace.lost_ms:.0f} ms lost; {pace.frames} frames"
    )


def _open_bus_sockets(stack: ExitStack, served: ServedArms, folder: Path | None) -> list[UnixBus | KernelBus]:
    """Open each CAN bus: a Unix socket in `folder`, or without a folder one of the kernel's interfaces."""
    sockets = []
    for side, bus in zip(served.sides, served.motor_simulation.buses, strict=True):
        sockets.append(_open_bus_socket(stack, bus.channel, folder))
        print_note(f"{bus.channel}: the {side} arm, {len(bus.motors)} motors")
    return sockets


def _open_bus_socket(stack: ExitStack, channel: str, folder: Path | None) -> UnixBus | KernelBus:
    from yamsim_cli.real.serve.can_bus import KernelBus, UnixBus

    bus = KernelBus(channel) if folder is None else UnixBus(folder, channel)
    stack.callback(bus.close)
    return bus


def _open_portals(stack: ExitStack, served: ServedArms, host: str, port: int | None) -> list[PolledServer]:
    from yamsim_cli.real.serve.portal import PortalServer

    ports: list[PolledServer] = []
    for k, follower in enumerate(served.followers if port is not None else ()):
        server = PortalServer(follower, host, port + k if port else 0)
        stack.callback(server.close)
        ports.append(server)
        print_note(f"{host}:{server.port}: calls by portal for the {served.sides[k]} arm")
    return ports


def _open_leaders(
    stack: ExitStack, session: Session, served: ServedArms, episode: Path, folder: Path | None
) -> PolledServer:
    from yamsim_cli.real.serve.leader_arms import LeaderArms, leader_channels, read_leader_motion

    motion = read_leader_motion(episode, session.config.rig, session.locations)
    buses = []
    for side, channel in leader_channels(served):
        buses.append(_open_bus_socket(stack, channel, folder))
        print_note(f"{channel}: the {side} leader, which performs {motion.duration:.1f} s of {episode}")
    return LeaderArms(served, motion, buses)


def _start_render_process(stack: ExitStack, session: Session, served: ServedArms, fps: float) -> RenderProcess:
    from yamsim_cli.real.serve.render_process import RenderProcess
    from yamsim_cli.real.serve.served_arms import served_cameras

    source = RenderProcess(session, served_cameras(session.config), fps, served.scene_state, time.time_ns)
    stack.callback(source.close)
    return source


def _camera_server(stack: ExitStack, folder: Path, source: RenderProcess, faults: Sequence[BusFault]) -> PolledServer:
    from yamsim_cli.real.serve.cameras import CameraServer

    server = CameraServer(folder, source, faults)
    stack.callback(server.close)
    print_note(f"{server.path}: pictures of {', '.join(source.cameras)}")
    return server


def _open_chiral_server(stack: ExitStack, robot: PolicyRobot, host: str, port: int) -> PolledServer:
    from yamsim_cli.real.serve.chiral import ChiralServer

    server = ChiralServer(robot, host, port)
    stack.callback(server.close)
    print_note(f"{host}:{server.port}: chiral, for raiden's policies")
    return server


def run_can_program(
    program: Annotated[list[str], typer.Argument(metavar="PROGRAM...", help="The program and its arguments.")],
    folder: Folder = None,
    json: Annotated[
        bool, typer.Option("--json", help="Run nothing; print the variables that the program would get, as JSON.")
    ] = False,
) -> None:
    """Run a python-can program on the buses of `yamsim serve-robot` in place of the machine's CAN interfaces.

    Example: yamsim can-run -- python -m i2rt.robots.motor_chain_robot --channel can0
    """
    from yamsim_cli.real.serve.can_bus import program_environment

    where = _bus_folder(folder)
    added = program_environment(os.environ, where)
    if json:
        print_json({"program": program, "environ": added})
        return
    try:
        os.execvpe(program[0], program, {**os.environ, **added})
    except OSError as error:
        kind = UsageError if isinstance(error, FileNotFoundError) else ResourceError
        raise kind(f"{program[0]}: cannot be run: {error.strerror}") from error


def _bus_folder(given: Path | None) -> Path:
    return default_socket_folder(os.environ) if given is None else given
