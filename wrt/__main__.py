"""`python -m wrt` is the command `wrt`."""

from wrt.cli import main

if __name__ == "__main__":
    main(prog_name="wrt")
