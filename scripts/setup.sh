#!/usr/bin/env bash
# Prepares the workspace: virtual environment, libraries, colcon build. Running it twice costs a second.
# Where ROS 2 Jazzy is sourced it is used; anywhere else on Linux x86-64 rclpy and Fast DDS come as wheels.
#
#   scripts/setup.sh        what the graph needs
#   scripts/setup.sh dev    and what tests, checks and benchmarks need
#   scripts/setup.sh docs   what the graph needs, and the generator of the documents' site
#   scripts/setup.sh release   what tests need, and the tools that check a release
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
want=${1:-run}
python=${PYTHON:-python3}
venv=$root/.venv
needed_mb=1000
[ "$want" = run ] || needed_mb=1500

# On a terminal one line shows what is being done; elsewhere each step is a line, without control codes.
terminal=no
[ -t 1 ] && [ "${TERM:-dumb}" != dumb ] && terminal=yes
columns=$( (tput cols) 2>/dev/null || echo 80)
clear_line() { [ $terminal = no ] || printf '\r\033[K'; }
step() { clear_line; if [ $terminal = yes ]; then printf '%s' "set-up ${1:0:$((columns - 9))}"; else printf '%s\n' "$1"; fi; }
fail() { clear_line; printf 'error: %s\n' "$1" >&2; exit 1; }

# Each longer step runs in a process group of its own. Ctrl-C, or a step that fails, ends all of them, and what was not
# finished has no mark, so that the next run does it again.
groups=()
meanwhile() {
  set -m
  "$@" < /dev/null &
  groups+=($!)
  set +m
}
wait_for() { meanwhile "$@"; wait $!; }
end_groups() {
  local code=$? group tries
  trap '' INT TERM HUP
  trap - EXIT
  for group in "${groups[@]}"; do kill -- -"$group" 2>/dev/null || true; done
  for tries in 1 2 3 4 5 6 7 8 9 10; do
    kill -0 "${groups[@]/#/-}" 2>/dev/null || break
    sleep 0.1
  done
  for group in "${groups[@]}"; do kill -KILL -- -"$group" 2>/dev/null || true; done
  [ $code -lt 128 ] || { clear_line; echo "interrupted; the next run goes on from here" >&2; }
  exit $code
}
trap end_groups EXIT
trap 'exit 130' INT
trap 'exit 143' TERM HUP

no_space() { # log
  ! grep -qiE 'No space left on device|Disk quota exceeded' "$1" \
    || fail "the disk of $root is full; free $needed_mb MB (docker system prune, pip cache purge), then run: make demo"
}
explain() { # log, what pip installed
  no_space "$1"
  if grep -qiE 'NewConnectionError|NameResolutionError|ConnectTimeout|ReadTimeout|ProxyError|Network is unreachable|Temporary failure in name resolution' "$1"; then
    fail "no connection to the Python package index; connect to the network (behind a proxy: export https_proxy=http://HOST:PORT), then run: make demo"
  fi
  clear_line
  tail -n 20 "$1" >&2
  fail "pip could not install $2; all it printed is in $1; then run: make demo"
}

# Linux ends an interpreter's path at the first blank of a script's first line.
case $root in *[[:space:]]*) fail "$root has a blank in its name, and the programs would not start there; move this folder" ;; esac
command -v "$python" >/dev/null || fail "$python is not installed; install it: sudo apt install python3 python3-venv (Debian and Ubuntu)"
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
    *)
      for other in python3.13 python3.12 python3.11 python3.10; do
        if command -v $other >/dev/null; then
          fail "$python is Python $version, and rclpy needs 3.10 to 3.13; run: make demo PYTHON=$other"
        fi
      done
      fail "$python is Python $version, and rclpy needs 3.10 to 3.13; install one: sudo apt install python3.12 python3.12-venv (Debian and Ubuntu), then run: make demo PYTHON=python3.12"
      ;;
  esac
fi

# The virtual environment, made anew when its python is another one, or its folder: its scripts name both.
if [ -f "$venv/.made-in" ] && [ "$(cat "$venv/.made-in")" != "$(pwd -P)" ]; then
  rm -rf "$venv"
fi
if [ -x "$venv/bin/python" ] && [ "$("$venv/bin/python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" != "$version" ]; then
  rm -rf "$venv"
fi
if [ ! -e "$venv/.installed-requirements" ]; then
  free_mb=$(df -Pm . | awk 'NR == 2 { print $4 }')
  [ "$free_mb" -ge $needed_mb ] || fail "the disk of $root is full: $free_mb MB are free, $needed_mb MB are needed; free some space (docker system prune, pip cache purge), then run: make demo"
fi
if [ ! -x "$venv/bin/pip" ] || [ ! -f "$venv/.made-in" ]; then
  step "[1/4] virtual environment in .venv (Python $version)"
  rm -rf "$venv"
  options=()
  [ $jazzy = yes ] && options=(--system-site-packages)
  made=$(mktemp)
  if ! wait_for "$python" -m venv "${options[@]}" "$venv" > "$made" 2>&1; then
    no_space "$made"
    fail "$python cannot make a virtual environment; install what it lacks: sudo apt install python$version-venv (Debian and Ubuntu), then run: make demo"
  fi
  rm -f "$made"
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

show_pip() { # file of requirements, whether the line moves; not awk, which may wait until it has read a block
  local line
  while IFS= read -r line; do
    case $line in
      Collecting*|Installing*|Building*) [ "$2" = 0 ] || step "[2/4] $line" ;;
      Successfully*) [ $terminal = yes ] || echo "      installed $1" ;;
    esac
  done
}
install() { # file of requirements, what it is, and whether another step runs at the same time
  local mark sum log
  mark=$venv/.installed-$(basename "$1" .txt)
  log=$venv/setup-$(basename "$1" .txt).log
  sum=$(cat requirements*.txt | sha256sum)
  [ -f "$mark" ] && [ "$(cat "$mark")" = "$sum" ] && return
  step "[2/4] $2"
  local show=0
  [ $terminal = yes ] && [ -z "${3:-}" ] && show=1
  # What is imported is compiled then; most of it never is.
  PIP_DISABLE_PIP_VERSION_CHECK=1 PYTHONUNBUFFERED=1 "$venv/bin/pip" install --no-compile "${constraints[@]}" -r "$1" 2>&1 | tee "$log" \
    | show_pip "$1" $show \
    || explain "$log" "$1"
  echo "$sum" > "$mark"
}

# The machine code of detector, stereo and the tracker's fit is cached beside its source, so that the first picture is not late.
compile() {
  [ $terminal = yes ] || step "[3/4] compile the corner detector, stereo and the tracker's fit, meanwhile"
  # What is kept is only compiled anew where its own file has changed, not one that it calls functions of.
  find "$root/src" -name '*.nb[ci]' -delete
  local path=$root/src/icu_common:$root/src/harris_perception${PYTHONPATH:+:$PYTHONPATH}
  PYTHONPATH=$path "$venv/bin/python" -c "from harris_perception.colour import soft_fit
from harris_perception.core.stereo import dense_stereo, stereo_matching
dense_stereo.warm()
stereo_matching.warm()
soft_fit.warm()" &
  local stereo=$!
  PYTHONPATH=$path "$venv/bin/python" -c "from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EdgeDetector
from harris_perception.core.corners.harris import HarrisConfig
for config in (HarrisConfig(), HarrisConfig(gradient='gaussian', window='gaussian')):
    CombinedDetector(config).warm()
EdgeDetector().warm()" && wait $stereo \
    || fail "the corner detector, stereo or the tracker's fit could not be compiled; see the lines above"
  echo "$kernels" > "$venv/.compiled"
}

# Python compiles each module at its first import; done here, the first start of the graph is as fast as later ones.
import_all() {
  local path
  path=$(printf '%s:' "$root"/src/*/)
  PYTHONPATH=$path${PYTHONPATH:-} "$venv/bin/python" -c '
import glob, importlib, re
for path in glob.glob("src/*/setup.py"):
    for module in set(re.findall(r"= ([\w.]+):main\"", open(path).read())):
        importlib.import_module(module)' > "$venv/setup-imports.log" 2>&1 \
    || { tail -n 5 "$venv/setup-imports.log" >&2; fail "the programs cannot be imported; see the lines above"; }
  echo "$now" > "$venv/.imported"
}
more_for_jazzy() { # what Ubuntu 24.04 has no package of
  "$venv/bin/python" -c 'import numba, rosbags, segno' 2>/dev/null && return
  step "[2/4] numba, rosbags and segno"
  "$venv/bin/pip" install "${constraints[@]}" numba "$(grep rosbags requirements-python.txt)" \
    "$(grep segno requirements-python.txt)" > "$venv/setup-requirements.log" 2>&1 \
    || explain "$venv/setup-requirements.log" "numba, rosbags and segno"
}

if [ $jazzy = no ]; then
  wait_for install requirements-python.txt "numpy, OpenCV, numba and other libraries"
else
  wait_for more_for_jazzy
fi
kernels=$(find src/harris_perception/harris_perception/{core,colour} -name '*.py' | sort | xargs cat | sha256sum)
if [ ! -f "$venv/.compiled" ] || [ "$(cat "$venv/.compiled")" != "$kernels" ]; then meanwhile compile; fi
if [ $jazzy = no ]; then wait_for install requirements.txt "rclpy and Fast DDS (with the others about 400 MB, a minute or so)"; fi
if [ "$want" = dev ] || [ "$want" = release ]; then meanwhile install requirements-dev.txt "tools for tests and checks, meanwhile" quiet; fi
case $want in
  docs) wait_for install requirements-docs.txt "generator of the documents' site" ;;
  release) wait_for install requirements-release.txt "tools that check a release" ;;
esac

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
  step "[4/4] colcon build"
  log=$venv/setup-colcon.log
  # The environment's python runs colcon, so that the installed programs start with it.
  # A build directory made under another path or python would keep its old links.
  rm -rf ros2_ws/build ros2_ws/install ros2_ws/log
  build() {
    cd ros2_ws && PATH="$venv/bin:$PATH" exec "$venv/bin/python" -m colcon build --symlink-install --event-handlers console_direct-
  }
  wait_for build > "$log" 2>&1 \
    || { no_space "$log"; clear_line; tail -n 40 "$log" >&2; fail "colcon build failed; all it printed is in $log"; }
  echo "$now" > $built
fi
if [ ! -f "$venv/.imported" ] || [ "$(cat "$venv/.imported")" != "$now" ]; then meanwhile import_all; fi

# With this the executables in ros2_ws/install/<package>/lib/<package>/ also start without sourcing the workspace.
for package in src/*/; do printf '%s\n' "$root/ros2_ws/build/$(basename "$package")"; done \
  > "$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/icu_workspace.pth"

[ $terminal = no ] || step "[4/4] what is still being compiled or installed (once; a minute or two)"
for group in "${groups[@]}"; do wait "$group"; done
trap - EXIT
clear_line
