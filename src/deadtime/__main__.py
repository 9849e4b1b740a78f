"""The command `deadtime`, and `python -m deadtime` where its script is not on the path."""

from typing import NoReturn

from deadtime.base.interrupts import end_on_interrupt


def main() -> NoReturn:
    """Run the command line; half a second of loading it can be interrupted, too."""
    end_on_interrupt()
    from deadtime.cli import main as run

    run()


if __name__ == "__main__":
    main()
