"""`python -m sonobench`."""

from sonobench.cli import main

if __name__ == "__main__":
    main()
