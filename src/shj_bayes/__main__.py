"""``python -m shj_bayes``: the command line where scripts are not on the path."""

from shj_bayes.cli import main

if __name__ == "__main__":
    main(prog_name="shj-bayes")
