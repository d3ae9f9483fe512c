"""``python -m ekfslam`` is the command."""

from ekfslam.cli import main

if __name__ == "__main__":
    main()
