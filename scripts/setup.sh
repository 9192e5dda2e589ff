# Shared by scripts/quickstart and scripts/test: system packages, a virtual environment, the package in it.
# Source it from bash; it leaves the repository's root as the working directory and $venv set.

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
cd "$root"
venv="$root/.venv"
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1 PIP_ROOT_USER_ACTION=ignore

step() { printf '\n==> %s\n' "$*"; }
fail() { printf 'error: %s\n' "$*" >&2; exit 1; }

# Print the first Python that is new enough; $PYTHON goes before all others.
find_python() {
  local candidate
  for candidate in ${PYTHON:-} python3 python3.13 python3.12 python3.11; do
    if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      command -v "$candidate"
      return
    fi
  done
}

# Print the Debian packages that are missing, one a line.
missing_packages() {
  local python="$1" entry
  command -v g++ >/dev/null || echo g++
  if [ -z "$python" ]; then
    printf '%s\n' python3 python3-venv python3-dev
  else
    "$python" -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
    "$python" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || echo python3-dev
  fi
  for entry in libEGL.so.1=libegl1 libGL.so.1=libgl1 libX11.so.6=libx11-6 libusb-1.0.so.0=libusb-1.0-0 libgomp.so.1=libgomp1; do
    ldconfig -p | grep -q "${entry%%=*}" || echo "${entry#*=}"
  done
}

install_system_packages() {
  local packages line as_root=()
  PATH="$PATH:/usr/sbin:/sbin"
  mapfile -t packages < <(missing_packages "$(find_python)")
  if [ ${#packages[@]} -eq 0 ]; then
    echo "all system packages are there"
    return
  fi
  line="apt-get install -y --no-install-recommends ${packages[*]}"
  command -v apt-get >/dev/null || fail "install with this system's package manager what Debian calls: ${packages[*]}"
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "run as root, then start again: $line"
    as_root=(sudo)
    [ -t 0 ] || sudo -n true 2>/dev/null || fail "sudo asks for a password; run this, then start again: sudo $line"
  fi
  echo "missing: ${packages[*]}"
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive $line -qq >/dev/null
  echo "installed"
}

# Print what the installation depends on, so that an unchanged one is left alone.
fingerprint() {
  local sources
  mapfile -t sources < <(find pwralign_kin/kernels -name '*.[ch]pp' | sort)
  { "$venv/bin/python" --version; cat pyproject.toml pwralign_kin/kernels/CMakeLists.txt "${sources[@]}"; } | sha256sum
}

# Install the package in place, with the extra $1 if given.
install_package() {
  local extra="${1:-}" python
  python="$(find_python)"
  [ -n "$python" ] || fail "no Python 3.11 or newer; name one with PYTHON=..."
  if [ ! -x "$venv/bin/pip" ]; then
    echo "creating ${venv##*/} with $python"
    "$python" -m venv --clear "$venv"
  fi
  if [ "$(cat "$venv/.installed$extra" 2>/dev/null)" = "$(fingerprint)" ]; then
    echo "already installed in ${venv##*/}"
    return
  fi
  echo "downloading the libraries and compiling the kernels; the first time takes a few minutes"
  "$venv/bin/pip" install --quiet --progress-bar off -e ".${extra:+[$extra]}"
  fingerprint | tee "$venv/.installed" > "$venv/.installed$extra"
  echo "installed in ${venv##*/}"
}

set_up() {
  step "System packages"
  install_system_packages
  step "Python package"
  install_package "$@"
}
