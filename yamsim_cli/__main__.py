"""Start of the executable. A signal that comes while its modules load is acted on once they are loaded."""

from __future__ import annotations

from .terminal.signals import defer_signals


def main() -> None:
    """Run the command line; never returns."""
    with defer_signals() as interrupted:
        from .main import main as run

        run(interrupted)


if __name__ == "__main__":
    main()
