"""`yamsim serve-robot`: the simulated arms behind what the real ones are reached by."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.flags.session import Json, Offline, Revision, Robot, opener
from yamsim_cli.flags.settings import ConfigOption, Object, Quality, Rig, Seed, Size, Target, Task
from yamsim_cli.terminal.console import note, print_json, print_line
from yamsim_cli.terminal.signals import stoppable

from .can_run import Folder, bus_folder

if TYPE_CHECKING:
    from yamsim_cli.core.serve.arms import Served
    from yamsim_cli.core.serve.can_bus import KernelBus, UnixBus
    from yamsim_cli.core.serve.loop import Port
    from yamsim_cli.core.serve.pictures import PictureProcess
    from yamsim_cli.core.serve.policy_robot import PolicyRobot
    from yamsim_cli.core.session import Session

# What two frames of 130 bits at 1 Mbit/s and the adapter's way through USB take: with seven motors 4 ms, the
# 250 Hz that the maker's SDK is made for.
_GAP_US = 571.0


def serve_robot(
    rig: Rig = None,
    revision: Revision = None,
    robot: Robot = None,
    task: Task = None,
    item: Object = None,
    target: Target = None,
    seed: Seed = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(help="Name of an arm's bus, the left one's first.  [default: can0, or can_left and can_right]"),
    ] = None,
    start: Annotated[
        str, typer.Option(metavar="rest|home|task", help="Where the arms stand at first, without power.")
    ] = "rest",
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="FAULT", help="lost:motor=3,at=5,for=2; hot:motor=2; drop:share=0.1; or stuck."),
    ] = None,
    gap: Annotated[
        float, typer.Option("--answer-gap", metavar="US", min=0, max=100_000, help="Time from one answer to the next.")
    ] = _GAP_US,
    kernel: Annotated[
        bool, typer.Option("--kernel", help="On CAN interfaces of the kernel's, such as vcan, instead of sockets.")
    ] = False,
    folder: Folder = None,
    portal: Annotated[
        int | None,
        typer.Option(
            min=0, max=65534, help="Also answer calls of portal's on this port, as 11333; the second arm on the next."
        ),
    ] = None,
    chiral: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Also be the robot of raiden's policies on this port, as 8765."),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address of --portal and --chiral. Beyond 127.0.0.1, anybody who reaches it drives the arm."),
    ] = "127.0.0.1",
    cameras: Annotated[
        bool, typer.Option("--cameras", help="Also hand out pictures, to camera readers of LeRobot's and raiden's.")
    ] = False,
    size: Size = None,
    quality: Quality = None,
    camera_fps: Annotated[
        float, typer.Option(min=0.1, max=120, help="Pictures a second of each camera, at most.")
    ] = 30.0,
    seconds: Annotated[float | None, typer.Option(min=0.1, max=1e6, help="End by itself after so long.")] = None,
    config: ConfigOption = "default",
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Simulate arms in real time, with motors on CAN buses that the maker's own SDK drives. Ctrl-C ends it.

    Example: yamsim serve-robot --rig yam_v1+linear_4310
    """
    from yamsim_cli.core.errors import UsageError
    from yamsim_cli.core.motors.bus import parse_fault

    faults = [parse_fault(text) for text in fault or ()]
    session = opener.open(
        config,
        renders=cameras or chiral is not None,
        parallel=False,
        rig=rig or "yam_v1+linear_4310",
        revision=revision,
        robot=robot,
        task=task,
        object=item,
        target=target,
        seed=seed,
        size=size,
        quality=quality,
    )

    from yamsim_cli.core.serve.arms import STARTS, policy_robot, serve_arms
    from yamsim_cli.core.serve.loop import ServeLoop

    if start not in STARTS:
        raise UsageError(f"--start {start!r} is not valid; valid: {', '.join(STARTS)}")
    served = serve_arms(session, channel or (), faults, start)
    with ExitStack() as stack, stoppable("Ending.") as stop:
        where = bus_folder(folder)
        sockets = _sockets(stack, served, None if kernel else where)
        ports = _portals(stack, served, host, portal)
        driven = None
        if cameras or chiral is not None:
            source = _pictures(stack, session, served, camera_fps)
            ports.append(source)
            if cameras:
                ports.append(_camera_server(stack, where, source))
            if chiral is not None:
                driven = policy_robot(session, served, source)
                ports.append(_chiral(stack, driven, host, chiral))
        note("Ctrl-C ends" if kernel else "yamsim can-run -- PROGRAM finds them; Ctrl-C ends")
        sys.stderr.flush()

        def drive() -> None:
            if driven is not None:
                driven.tick()
            for follower in served.followers:
                follower.tick()

        loop = ServeLoop(served.plant, sockets, gap * 1e-6, ports, drive)
        loop.run(lambda: stop.asked, float("inf") if seconds is None else seconds)
        pace = loop.pace
    if json:
        print_json({"channels": [bus.channel for bus in served.plant.buses], **asdict(pace)})
        return
    print_line(
        f"{pace.steps} steps in {pace.seconds:.1f} s, the latest {pace.late_ms:.2f} ms late, {pace.late_steps} by more "
        f"than a step, {pace.lost_ms:.0f} ms lost; {pace.frames} frames"
    )


def _sockets(stack: ExitStack, served: Served, folder: Path | None) -> list[UnixBus | KernelBus]:
    """A socket for each bus, in a folder; without one, the kernel's."""
    from yamsim_cli.core.serve.can_bus import KernelBus, UnixBus

    sockets: list[UnixBus | KernelBus] = []
    for side, bus in zip(served.sides, served.plant.buses, strict=True):
        one = KernelBus(bus.channel) if folder is None else UnixBus(folder, bus.channel)
        stack.callback(one.close)
        sockets.append(one)
        note(f"{bus.channel}: the {side} arm, {len(bus.motors)} motors")
    return sockets


def _portals(stack: ExitStack, served: Served, host: str, port: int | None) -> list[Port]:
    from yamsim_cli.core.serve.portal import PortalServer

    ports: list[Port] = []
    for k, follower in enumerate(served.followers if port is not None else ()):
        server = PortalServer(follower, host, port + k if port else 0)
        stack.callback(server.close)
        ports.append(server)
        note(f"{host}:{server.port}: calls of portal's for the {served.sides[k]} arm")
    return ports


def _pictures(stack: ExitStack, session: Session, served: Served, fps: float) -> PictureProcess:
    from yamsim_cli.core.serve.arms import served_cameras
    from yamsim_cli.core.serve.pictures import PictureProcess

    source = PictureProcess(session, served_cameras(session.config), fps, served.state, time.time_ns)
    stack.callback(source.close)
    return source


def _camera_server(stack: ExitStack, folder: Path, source: PictureProcess) -> Port:
    from yamsim_cli.core.serve.cameras import CameraServer

    server = CameraServer(folder, source)
    stack.callback(server.close)
    note(f"{server.path}: pictures of {', '.join(source.cameras)}")
    return server


def _chiral(stack: ExitStack, robot: PolicyRobot, host: str, port: int) -> Port:
    from yamsim_cli.core.serve.chiral import ChiralServer

    server = ChiralServer(robot, host, port)
    stack.callback(server.close)
    note(f"{host}:{server.port}: chiral, for raiden's policies")
    return server
