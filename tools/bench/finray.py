"""Figures of docs/finray.md: force against deflection, contact area, and pressing force of fin-ray fingers.

    python -m tools.bench.finray

Prints the tables, and draws docs/images/finray_force.png.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tests.core.robots.test_finray import CLOSE, cylinder, pushed, strawberry
from tests.hands import finger, grip
from tests.plane_frame import PlaneFrame, bent, compliance

HEIGHTS = (0.04, 0.065)
FORCES = (1.0, 2.5, 5.0, 7.5, 10.0, 12.5, 15.0)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "finray_force.png"


def main() -> None:
    """Measure everything."""
    soft, frame = finger(), PlaneFrame(finger())
    measured = {height: [pushed(height, force) for force in FORCES] for height in HEIGHTS}
    for height in HEIGHTS:
        print(f"pushed {height * 1000:g} mm over the base: elastic frame, springs' theory, physics; in mm, and degrees")
        for force, (far, turned) in zip(FORCES, measured[height], strict=True):
            by_frame, _, frame_turn = frame.pushed(height, force)
            deflections = by_frame, force * compliance(soft, height), far
            turns = frame_turn, bent(soft, height, force).sum(), turned
            print(
                f"  {force:5.1f} N:",
                *(f"{x * 1e3:6.2f}" for x in deflections),
                *(f"{np.degrees(x):6.1f}" for x in turns),
            )
    _draw({height: [far for far, _ in values] for height, values in measured.items()}, frame)
    print("on a cylinder 60 mm across: command, force of a finger, pads' area nearer than 0.1 mm")
    for name, command, grip_height in (
        ("linear_4310", CLOSE, None),
        ("finray", CLOSE, None),
        ("finray", CLOSE, 0.117),
        ("finray", 0.0, 0.117),
    ):
        found = grip(name, cylinder, command, start=0.04, height=grip_height)
        where = "" if grip_height is None else f" at {grip_height * 1000:g} mm over the flange"
        print(f"  {name}{where}: {command * 1000:g} mm, {found.forces[-1]:.1f} N, {found.area * 1e6:.0f} mm2")
    print("told to close wholly on a strawberry: force of a finger at rest, at its most, of one contact, and area")
    for name in ("linear_4310", "linear_3507", "crank_4310", "flexible_4310", "finray"):
        found = grip(name, strawberry, 0.0, start=0.0375)
        forces = found.forces[-1], found.forces.max(), found.most
        print(f"  {name}:", *(f"{force:.1f} N," for force in forces), f"{found.area * 1e6:.0f} mm2")


def _draw(measured: dict[float, list[float]], frame: PlaneFrame) -> None:
    """Lines for the elastic frame, dots for physics; deflection to the right, force upwards."""
    width, height, left, low, far, most = 640, 400, 60, 50, 0.018, 16.0
    image = np.full((2 * height, 2 * width, 3), 255, np.uint8)

    def at(x: float, force: float) -> tuple[int, int]:
        right, up = left + x / far * (width - left - 20), low + force / most * (height - low - 20)
        return round(2 * right), round(2 * (height - up))

    def text(words: str, place: tuple[int, int], colour: tuple[int, int, int] = (60, 60, 60)) -> None:
        cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.85, colour, 2, cv2.LINE_AA)

    for mm in range(0, 19, 3):
        cv2.line(image, at(mm / 1000, 0), at(mm / 1000, most), (225, 225, 225), 2)
        x, y = at(mm / 1000, 0)
        text(str(mm), (x - 14, y + 34))
    for newtons in range(0, 16, 5):
        cv2.line(image, at(0, newtons), at(far, newtons), (225, 225, 225), 2)
        x, y = at(0, newtons)
        text(str(newtons), (x - 44, y + 10))
    x, y = at(far * 0.62, 0)
    text("pushed in by, mm", (x, y + 76))
    text("force, N", (14, 40))
    for (where, values), colour in zip(measured.items(), ((40, 110, 235), (150, 90, 30)), strict=True):
        cv2.line(image, at(0, 0), at(frame.pushed(where, 15.0)[0], 15.0), colour, 3, cv2.LINE_AA)
        for force, deflection in zip(FORCES, values, strict=True):
            cv2.circle(image, at(float(deflection), force), 9, colour, -1, cv2.LINE_AA)
        end = at(frame.pushed(where, 15.0)[0], 15.0)
        text(f"{where * 1000:g} mm", (end[0] + (10 if where == HEIGHTS[0] else -100), end[1] - 16), colour)
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(PICTURE), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
