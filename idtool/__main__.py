"""`idtool`, and `python -m idtool`."""

from idtool.common.interrupt import exit_on_interrupt
from idtool.common.memory import pause_garbage_collection


def main() -> None:
    """Run the command line."""
    exit_on_interrupt()
    pause_garbage_collection()
    from idtool.cli import main as run

    run()


if __name__ == "__main__":
    main()
