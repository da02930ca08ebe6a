"""`python -m imubayes` is the command `imubayes`."""

from imubayes.cli.main import main

if __name__ == "__main__":
    main()
