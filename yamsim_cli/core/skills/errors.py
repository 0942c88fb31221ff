"""Why a skill could not do its work."""

from __future__ import annotations

from ..types import Cause


class SkillFailedError(Exception):
    """A skill found no way, or its effect did not come about. It is data, and no error of the program.

    Attributes:
        cause: as an outcome tells it.
    """

    def __init__(self, cause: Cause, detail: str) -> None:
        super().__init__(detail)
        self.cause = cause
