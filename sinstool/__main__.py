"""`python -m sinstool`, for use where scripts are not on the PATH."""

from sinstool.cli.main import main

if __name__ == "__main__":
    main()
