#!/bin/sh
# Install what is missing, and say nothing when nothing is: Debian's packages through apt, the rest into .venv.
#   ./setup.sh         what a run needs
#   ./setup.sh dev     what the tests and the linters need too (or another extra of pyproject.toml)
set -eu
cd "$(dirname "$0")"

packages="python3-dolfinx python3-petsc4py python3-mpi4py python3-gmsh python3-h5py python3-scipy python3-sympy
    python3-matplotlib python3-meshio python3-venv python3-dev gcc make openmpi-bin libopenmpi-dev ca-certificates"
extra=${1:-}
log=build/setup.log

say() { echo "setup: $*" >&2; }
mkdir -p build

# ---- Debian's packages
if ! command -v dpkg-query > /dev/null; then
    say "this is no Debian system; extremal runs on Debian 12 and 13 with these packages:"
    say "    "$packages
    exit 1
fi
installed=$(dpkg-query -W -f '${db:Status-Status}:${Package}\n' $packages 2> /dev/null || true)
missing=
for package in $packages; do
    echo "$installed" | grep -qx "installed:$package" || missing="$missing $package"
done

if [ -n "$missing" ]; then
    install="apt-get install -y --no-install-recommends$missing"
    if [ "$(id -u)" = 0 ]; then
        as_root=
    elif command -v sudo > /dev/null && sudo -n true 2> /dev/null; then
        as_root="sudo -n"
    else
        say "these Debian packages are missing, and only root can install them:$missing"
        say "as root (su - or sudo), run:"
        say "    apt-get update && $install"
        say "then repeat your command."
        exit 1
    fi
    say "installing Debian packages; this can take some minutes (log in $log):$missing"
    # an update that fails for one source may still leave what is needed: the installation decides
    $as_root apt-get update > "$log" 2>&1 < /dev/null || true
    if ! $as_root env DEBIAN_FRONTEND=noninteractive $install -o DPkg::Lock::Timeout=300 \
        >> "$log" 2>&1 < /dev/null; then
        tail -n 12 "$log" >&2
        say "apt could not install the packages (whole log in $log). The command was:"
        say "    $install"
        exit 1
    fi
fi

# ---- .venv over Debian's Python
version=$(basename "$(readlink -f /usr/bin/python3)")
stamp=.venv/ready${extra:+-$extra}
wanted="$(pwd -P) $version $(cksum < pyproject.toml)" # a moved folder or a new Python asks for a new installation
if [ "$(cat "$stamp" 2> /dev/null)" = "$wanted" ]; then
    exit 0
fi
if ! { [ -x .venv/bin/pip ] && [ -d ".venv/lib/$version/site-packages" ] &&
    grep -q "include-system-site-packages = true" .venv/pyvenv.cfg; }; then
    say "making .venv"
    /usr/bin/python3 -m venv --clear --system-site-packages .venv
fi
say "installing extremal and what it needs from PyPI into .venv"
if ! .venv/bin/python -m pip install -qq --disable-pip-version-check --no-input --retries 2 \
    -e ".${extra:+[$extra]}" > "$log" 2>&1 < /dev/null; then
    { grep '^ *ERROR' "$log" || tail -n 12 "$log"; } >&2
    say "pip could not install the Python packages which pyproject.toml asks for (whole log in $log)."
    say "This step needs PyPI once; behind a proxy set https_proxy, or PIP_INDEX_URL for a mirror, and try again."
    exit 1
fi
if ! .venv/bin/python -c "import dolfinx, gmsh, h5py, matplotlib, meshio, pydantic, rich, sympy" > "$log" 2>&1; then
    tail -n 5 "$log" >&2
    say "the packages are installed but cannot be imported together (above); is another Python library in the way"
    say "(PYTHONPATH, ~/.local)?"
    exit 1
fi
echo "$wanted" > "$stamp"
