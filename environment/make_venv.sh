#!/usr/bin/env bash
# make_venv.sh PYTHON FOLDER [solver]: a virtual environment with the wheels of wheels.txt above a PYTHON that has DOLFINx;
# with the word solver DOLFINx comes as wheels too. bcid is imported from the clone that $BCID_PROJECT names: all share the venv.
set -euo pipefail

python=$1
bin=$2/bin
lists=$(dirname -- "${BASH_SOURCE[0]}")
wanted=(-r "$lists/wheels.txt")

if [ "${3:-}" = solver ]; then
    # Nothing of the system below is needed, and nothing shall be taken for a part of it.
    "$python" -m venv "$2"
    wanted+=(-r "$lists/solver.txt")
else
    "$python" -m venv --without-pip --system-site-packages "$2"
fi
site=$("$bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
if [ "${3:-}" != solver ]; then
    # A venv made from a venv sees the system below both, and not the first one.
    "$python" -c 'import sys; sys.prefix != sys.base_prefix and print(*(p for p in sys.path if p.startswith(sys.prefix)), sep="\n")' \
        >"$site/bcid-below.pth"
    "$bin/python" -m pip --version || "$bin/python" -m ensurepip
    # NumPy stays the one that DOLFINx was built for.
    "$bin/python" -c 'import numpy; print("numpy==" + numpy.__version__)' >"$2/numpy.txt"
    wanted+=(scipy -c "$2/numpy.txt")
fi
"$bin/python" -m pip install --no-input --retries 2 --no-cache-dir --disable-pip-version-check "${wanted[@]}"
echo "import os, sys; p = os.environ.get('BCID_PROJECT'); p and p not in sys.path and sys.path.insert(0, p)" >"$site/bcid-project.pth"

# Commands, and the modules whose main() they call. They begin as shell scripts, for the path of the interpreter may have spaces.
while read -r name module; do
    printf '%s\n' '#!/bin/sh' "'''exec' '$bin/python' \"\$0\" \"\$@\"" "' '''" \
        'import sys' "from $module import main" 'sys.exit(main())' >"$bin/$name"
    chmod +x -- "$bin/$name"
done <<END
bcid bcid.app.cli
bcid-validate validation.__main__
END

# Scripts name their interpreter by its full path, and a folder NAME.partial becomes NAME.
grep -rlIZ -- .partial/ "$bin" | xargs -r0 sed -i 's|\.partial/|/|g' || true
