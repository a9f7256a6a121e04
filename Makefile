# Two commands do everything on a fresh machine with Python 3.11 (or newer) and make: `make demo` and `make test`.
# The same for Windows, and without make anywhere: python tasks.py demo, python tasks.py test.

PYTHON ?= python3

.PHONY: install install-docs install-reference demo test lint check docs prove fuzz robust golden kill thousand calibrate audit minimum recover speed bench bench-app clean

install install-docs install-reference demo test lint check docs prove fuzz robust golden kill thousand calibrate audit minimum recover speed bench bench-app:
	$(PYTHON) tasks.py $@

clean:
	rm -rf .venv shj-bayes-demo shj-bayes-tables shj-bayes-proof
