#!/bin/sh
# The lowest versions that pyproject.toml allows, in a venv of their own (.lowest): a quick part of the tests.
# usage: tests/lowest_versions.sh [arguments of pytest]
set -eu
cd "$(dirname "$0")/.."
PYTHON=${PYTHON:-python3}
[ $# -gt 0 ] || set -- tests/exact tests/spec tests/certify/test_lmi.py tests/certify/test_clock.py tests/families/test_contract.py \
    tests/report tests/simulate tests/test_cli.py tests/test_command_matrix.py tests/test_findings.py
"$PYTHON" -m venv --clear .lowest
"$PYTHON" - > .lowest/constraints.txt <<'END'
import re, tomllib
for one in tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]:
    print(re.sub(r">=\s*", "==", one))
END
.lowest/bin/python -m pip install --quiet --constraint .lowest/constraints.txt . cvxpy hypothesis jsonschema pytest
.lowest/bin/python -m pip freeze
# The package is installed: what is tested is that, with the tests of this folder.
CDOBS_MUTANTS=${CDOBS_MUTANTS:-2000} .lowest/bin/python -m pytest -p no:cacheprovider "$@"
