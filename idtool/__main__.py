"""`idtool`, and `python -m idtool`."""

from idtool.common.interrupt import at_once


def main() -> None:
    """Run the command line."""
    at_once()
    from idtool.cli import main as run

    run()


if __name__ == "__main__":
    main()
