#!/usr/bin/env bash
# Prepares the workspace: virtual environment, libraries, colcon build. Running it twice costs a second.
# Where ROS 2 Jazzy is sourced it is used; anywhere else on Linux x86-64 rclpy and Fast DDS come as wheels.
#
#   scripts/setup.sh        what the graph needs
#   scripts/setup.sh dev    and what tests, checks and benchmarks need
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
want=${1:-run}
python=${PYTHON:-python3}
venv=$root/.venv

fail() { printf 'error: %s\n' "$1" >&2; exit 1; }

# Linux ends an interpreter's path at the first blank of a script's first line.
case $root in *[[:space:]]*) fail "$root has a blank in its name, and the programs would not start there; move this folder" ;; esac
command -v "$python" >/dev/null || fail "$python is not installed; install Python 3.10 to 3.13 (Debian and Ubuntu: apt install python3 python3-venv)"
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
jazzy=no
if [ "${ROS_DISTRO:-}" = jazzy ]; then
  "$python" -c 'import rclpy' 2>/dev/null || fail "ROS_DISTRO is jazzy, but $python cannot import rclpy; source /opt/ros/jazzy/setup.bash again, or unset ROS_DISTRO to use the wheels"
  command -v colcon >/dev/null || fail "colcon is missing; install it with: apt install python3-colcon-common-extensions"
  jazzy=yes
elif [ -n "${ROS_DISTRO:-}" ]; then
  fail "ROS_DISTRO is $ROS_DISTRO, this graph is for jazzy; use a shell without it, or source Jazzy"
else
  [ "$(uname -s)-$(uname -m)" = Linux-x86_64 ] || fail "without ROS 2 Jazzy only Linux on x86-64 works ($(uname -s) on $(uname -m) here); install Jazzy and source it"
  case $version in
    3.10|3.11|3.12|3.13) ;;
    *) fail "the wheels of rclpy need Python 3.10 to 3.13, $python is $version; name another one: make PYTHON=python3.12 ..." ;;
  esac
fi

# The virtual environment, made anew when its python is another one, or its folder: its scripts name both.
if [ -f "$venv/.made-in" ] && [ "$(cat "$venv/.made-in")" != "$(pwd -P)" ]; then
  rm -rf "$venv"
fi
if [ -x "$venv/bin/python" ] && [ "$("$venv/bin/python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" != "$version" ]; then
  rm -rf "$venv"
fi
if [ ! -x "$venv/bin/pip" ]; then
  echo "[1/4] virtual environment in .venv (Python $version)"
  rm -rf "$venv"
  options=()
  [ $jazzy = yes ] && options=(--system-site-packages)
  "$python" -m venv "${options[@]}" "$venv" || fail "$python -m venv failed; install it (Debian and Ubuntu: apt install python3-venv)"
  pwd -P > "$venv/.made-in"
fi

# On Jazzy, Ubuntu's OpenCV must find the numpy that it was compiled for, whatever else pip installs.
constraints=()
if [ $jazzy = yes ]; then
  "$python" -c 'import cv2, numpy, serial, yaml, aiohttp, psutil' 2>/dev/null \
    || fail "libraries are missing; install them with: rosdep install --from-paths src --ignore-src -y --skip-keys python3-numba"
  "$python" -c 'import numpy; print("numpy==" + numpy.__version__)' > "$venv/constraints.txt"
  constraints=(--constraint "$venv/constraints.txt")
fi

install() { # file of requirements, what it is
  local mark
  mark=$venv/.installed-$(basename "$1" .txt)
  local sum
  sum=$(cat requirements*.txt | sha256sum)
  [ -f "$mark" ] && [ "$(cat "$mark")" = "$sum" ] && return
  echo "[2/4] $2"
  # On a terminal one line shows what pip is at; elsewhere, and in the background, only the end is printed.
  local show=0
  [ -t 1 ] && [ $BASHPID = $$ ] && show=1
  # What is imported is compiled then; most of it never is.
  PIP_DISABLE_PIP_VERSION_CHECK=1 "$venv/bin/pip" install --no-compile "${constraints[@]}" -r "$1" | awk -v show=$show -v file="$1" '
      /^(Collecting|Installing|Building)/ && show { printf "\r\033[K      %s", substr($0, 1, 90); fflush() }
      /^Successfully/ { if (show) printf "\r\033[K"; print "      installed " file }' \
    || fail "pip could not install $1; see the lines above (a proxy or an offline machine?), then run this again"
  echo "$sum" > "$mark"
}
# What takes long and is not needed at once is done meanwhile, in groups of its own, which end when this ends.
others=()
meanwhile() {
  set -m
  "$@" &
  others+=($!)
  set +m
}
trap 'kill -- "${others[@]/#/-}" 2>/dev/null || true' EXIT

# The machine code of detector and stereo is cached beside its source, so that the first picture is not late.
compile() {
  echo "[3/4] compile the corner detector and stereo, meanwhile"
  # What is kept is only compiled anew where its own file has changed, not one that it calls functions of.
  find "$root/src" -name '*.nb[ci]' -delete
  local path=$root/src/icu_common:$root/src/harris_perception${PYTHONPATH:+:$PYTHONPATH}
  PYTHONPATH=$path "$venv/bin/python" -c "from harris_perception.core import dense_stereo, stereo_matching
dense_stereo.warm()
stereo_matching.warm()" &
  local stereo=$!
  PYTHONPATH=$path "$venv/bin/python" -c "from harris_perception.core.edges import CombinedDetector, EdgeDetector
from harris_perception.core.harris import HarrisConfig
for config in (HarrisConfig(), HarrisConfig(gradient='gaussian', window='gaussian')):
    CombinedDetector(config).warm()
EdgeDetector().warm()" && wait $stereo \
    || fail "the corner detector or stereo could not be compiled; see the lines above"
  echo "$kernels" > "$venv/.compiled"
}

if [ $jazzy = no ]; then
  install requirements-python.txt "numpy, OpenCV, numba and other libraries"
else
  # Ubuntu 24.04 has no package of numba and rosbags.
  "$venv/bin/python" -c 'import numba, rosbags' 2>/dev/null \
    || { echo "[2/4] numba, rosbags"; "$venv/bin/pip" install --quiet "${constraints[@]}" numba "$(grep rosbags requirements-python.txt)"; } \
    || fail "pip could not install numba and rosbags into .venv; see the lines above"
fi
kernels=$(cat src/harris_perception/harris_perception/core/*.py | sha256sum)
if [ ! -f "$venv/.compiled" ] || [ "$(cat "$venv/.compiled")" != "$kernels" ]; then meanwhile compile; fi
if [ $jazzy = no ]; then install requirements.txt "rclpy and Fast DDS (with the others about 400 MB, a minute or so)"; fi
if [ "$want" = dev ]; then meanwhile install requirements-dev.txt "tools for tests and checks, meanwhile"; fi

# colcon only sees an environment made by local_setup files; this one lets it find the wheels' messages.
if [ $jazzy = no ]; then
  for shell in sh bash zsh; do
    printf 'export AMENT_PREFIX_PATH="%s${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"\n' "$venv" > "$venv/local_setup.$shell"
  done
fi

# Modules are linked, so only a changed description or a new configuration file needs a new build.
built=ros2_ws/install/.built
now=$(cat src/*/setup.py src/*/setup.cfg src/*/package.xml | sha256sum; find config src/*/launch -type f 2>/dev/null | sort | sha256sum; echo "$root $jazzy $version")
if [ ! -f $built ] || [ "$(cat $built)" != "$now" ]; then
  echo "[4/4] colcon build"
  log=$(mktemp)
  # The environment's python runs colcon, so that the installed programs start with it.
  # A build directory made under another path or python would keep its old links.
  rm -rf ros2_ws/build ros2_ws/install ros2_ws/log
  (cd ros2_ws && PATH="$venv/bin:$PATH" "$venv/bin/python" -m colcon build --symlink-install --event-handlers console_direct- >"$log" 2>&1) \
    || { cat "$log" >&2; rm -f "$log"; fail "colcon build failed; see the lines above"; }
  rm -f "$log"
  echo "$now" > $built
fi

# With this the executables in ros2_ws/install/<package>/lib/<package>/ also start without sourcing the workspace.
for package in src/*/; do printf '%s\n' "$root/ros2_ws/build/$(basename "$package")"; done \
  > "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/icu_workspace.pth"

for other in "${others[@]}"; do wait "$other"; done
trap - EXIT
