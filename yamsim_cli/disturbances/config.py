"""The config of the disturbances of demonstrations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, FiniteFloat

from ..core.files.documents.config_base import Config, require_ordered
from ..core.files.documents.units import QuantityBounds, Share

_Noise = Annotated[FiniteFloat, QuantityBounds("rad", 0, 0.1)]
_Seconds = Annotated[FiniteFloat, QuantityBounds("s", 0, 60)]
_Speed = Annotated[FiniteFloat, QuantityBounds("m/s", 0, 2)]
_SecondsRange = Annotated[tuple[_Seconds, _Seconds], AfterValidator(require_ordered)]
_SpeedRange = Annotated[tuple[_Speed, _Speed], AfterValidator(require_ordered)]


class DisturbanceConfig(Config):
    """Disturbances of the expert, so that demonstrations show recoveries. The success of an attempt is still judged.

    Each kind is sampled from the attempt's seed, with its own random stream. The recorded action of a frame, `ctrl`, is
    the expert's command without noise and delay; the drives get the disturbed command, which is `sim_ctrl`. Source:
    DART (Laskey et al., 2017), which records the supervisor's action while noise acts on the robot.

    Attributes:
        noise_rad: standard deviation of the noise on the commands to the joints of the acting arms, rad; 0 for none.
        noise_correlation_s: time in which the correlation of the noise falls to 1/e, s; 0 for white noise. A motor
            filters white noise out, so that the hand hardly moves.
        push_probability: share of the attempts in which one object that the task picks up is pushed once.
        push_mps: range of the horizontal speed that a push adds to the object, m/s. Its direction is uniform.
        push_time_s: range of the time of the push after the start, s.
        late_grasp_probability: share of the attempts in which the first grasp is late.
        late_grasp_s: range of the delay of that grasp, s. The fingers or the weld act late, but the arm does not
            wait, so the hand may miss the object.
    """

    noise_rad: _Noise = 0.005
    noise_correlation_s: _Seconds = 0.2
    push_probability: Share = 0.5
    push_mps: _SpeedRange = (0.3, 0.8)
    push_time_s: _SecondsRange = (0.5, 2.5)
    late_grasp_probability: Share = 0.3
    late_grasp_s: _SecondsRange = (0.2, 0.8)


@dataclass(frozen=True)
class PushSample:
    """A push of one attempt.

    Attributes:
        thing: name of the object.
        tick: control tick before which the object is pushed.
        velocity: added linear velocity (3,) in `world`, m/s.
    """

    thing: str
    tick: int
    velocity: tuple[float, float, float]
