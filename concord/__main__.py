"""`python -m concord`: the command line where the script `concord` is not on the path."""

from concord.experiments.__main__ import main

if __name__ == "__main__":
    main()
