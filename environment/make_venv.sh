#!/usr/bin/env bash
# make_venv.sh PYTHON FOLDER own|wheels: a virtual environment with the wheels of wheels.txt above a PYTHON that has DOLFINx of its
# own, or with DOLFINx as wheels too. bcid is imported from the clone that $BCID_PROJECT names: clones share the environment.
set -euo pipefail

bin=$2/bin
lists=$(dirname -- "${BASH_SOURCE[0]}")
wanted=(-r "$lists/wheels.txt")

if [ "$3" = wheels ]; then
    # Nothing of the system below is needed, and nothing shall be taken for a part of it.
    "$1" -m venv "$2"
    wanted+=(-r "$lists/solver.txt")
else
    "$1" -m venv --without-pip --system-site-packages "$2"
    "$bin/python" -m pip --version || "$bin/python" -m ensurepip
    # NumPy stays the one that DOLFINx was built for.
    "$bin/python" -c 'import numpy; print("numpy==" + numpy.__version__)' >"$2/numpy.txt"
    wanted+=(scipy -c "$2/numpy.txt")
fi
"$bin/python" -m pip install --no-input --retries 2 --no-cache-dir --disable-pip-version-check "${wanted[@]}"

clone="import os, sys; p = os.environ.get('BCID_PROJECT'); p and p not in sys.path and sys.path.insert(0, p)"
echo "$clone" >"$("$bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/bcid-project.pth"
for module in bcid validation; do
    name=${module/validation/bcid-validate}
    printf '#!/bin/sh\nexec "%s" -P -m %s "$@"\n' "$bin/python" "$module" >"$bin/$name"
    chmod +x -- "$bin/$name"
done
# Scripts name their interpreter by its full path, and a folder NAME.partial becomes NAME.
grep -rlIZ -- .partial/ "$bin" | xargs -r0 sed -i 's|\.partial/|/|g' || true
