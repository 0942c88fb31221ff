"""`yamsim serve-robot`: the simulated arms behind what the real ones are reached by."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import asdict
from typing import Annotated

import typer

from .can_run import Folder, bus_folder
from .console import note, print_json, print_line
from .session import Json, Revision, Robot, opener
from .settings import ConfigOption, Object, Rig, Seed, Target, Task
from .signals import stoppable

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
    host: Annotated[
        str, typer.Option(help="Address of --portal. Beyond 127.0.0.1, anybody who reaches it can drive the arm.")
    ] = "127.0.0.1",
    seconds: Annotated[float | None, typer.Option(min=0.1, max=1e6, help="End by itself after so long.")] = None,
    config: ConfigOption = "default",
    json: Json = False,
) -> None:
    """Simulate arms in real time, with motors on CAN buses that the maker's own SDK drives. Ctrl-C ends it.

    Example: yamsim serve-robot --rig yam_v1+linear_4310
    """
    from yamsim_cli.core.config.pairs import require_pair
    from yamsim_cli.core.errors import UsageError
    from yamsim_cli.core.motors.faults import parse_fault

    faults = [parse_fault(text) for text in fault or ()]
    session = opener.open(
        config,
        renders=False,
        rig=rig or "yam_v1+linear_4310",
        revision=revision,
        robot=robot,
        task=task,
        object=item,
        target=target,
        seed=seed,
    )
    require_pair(session.config, "serve-robot")

    from yamsim_cli.core.serve.arms import STARTS, serve_arms
    from yamsim_cli.core.serve.loop import ServeLoop
    from yamsim_cli.core.serve.portal import PortalServer
    from yamsim_cli.core.serve.sockets import KernelBus, UnixBus

    if start not in STARTS:
        raise UsageError(f"--start {start!r} is not valid; valid: {', '.join(STARTS)}")
    served = serve_arms(session, channel or (), faults, start)
    with ExitStack() as stack, stoppable("Ending.") as stop:
        sockets = []
        for side, bus in zip(served.sides, served.plant.buses, strict=True):
            one = KernelBus(bus.channel) if kernel else UnixBus(bus_folder(folder), bus.channel)
            stack.callback(one.close)
            sockets.append(one)
            note(f"{bus.channel}: the {side} arm, {len(bus.motors)} motors")
        portals = []
        for k, follower in enumerate(served.followers if portal is not None else ()):
            server = PortalServer(follower, host, portal + k if portal else 0)
            stack.callback(server.close)
            portals.append(server)
            note(f"{host}:{server.port}: calls of portal's for the {served.sides[k]} arm")
        note("Ctrl-C ends" if kernel else "yamsim can-run -- PROGRAM finds them; Ctrl-C ends")
        sys.stderr.flush()

        def drive() -> None:
            for follower in served.followers if portals else ():
                follower.tick()

        loop = ServeLoop(served.plant, sockets, gap * 1e-6, portals, drive)
        loop.run(lambda: stop.asked, float("inf") if seconds is None else seconds)
    pace = loop.pace
    if json:
        print_json({"channels": [bus.channel for bus in served.plant.buses], **asdict(pace)})
        return
    print_line(
        f"{pace.steps} steps in {pace.seconds:.1f} s, the latest {pace.late_ms:.2f} ms late, {pace.late_steps} by more "
        f"than a step, {pace.lost_ms:.0f} ms lost; {pace.frames} frames"
    )
