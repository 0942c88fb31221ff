"""Start of the executable: a signal that comes while its modules load counts as soon as they have."""

from __future__ import annotations

from .commands.signals import noted_signals


def main() -> None:
    """Run the command line; never returns."""
    with noted_signals() as interrupted:
        from .main import main as run

        run(interrupted)


if __name__ == "__main__":
    main()
