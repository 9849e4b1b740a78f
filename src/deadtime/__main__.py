"""`python -m deadtime`: the command line, where the script `deadtime` is not on the path."""

from deadtime.cli.entry import main

if __name__ == "__main__":
    main()
