"""Entry point of the executable. A signal that arrives during the imports takes effect after them."""

from __future__ import annotations

from .terminal.signals import defer_signals


def main() -> None:
    """Run the command line, and end the process with its exit code."""
    with defer_signals() as interrupted:
        from .main import main as run

        run(interrupted)


if __name__ == "__main__":
    main()
