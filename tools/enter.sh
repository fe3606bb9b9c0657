# Source this in bash: it gives the shell ROS 2 Jazzy's Python and, once built, this package.
# A ROS installation that has been sourced is used as it is; otherwise .venv (`make setup`) is.
_top="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
if [ "${ROS_DISTRO:-}" != jazzy ] && [ -f "${VENV:-$_top/.venv}/bin/activate" ]; then
    . "${VENV:-$_top/.venv}/bin/activate"
    export AMENT_PREFIX_PATH="$VIRTUAL_ENV${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
fi
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
if [ -f "$_top/${INSTALL_BASE:-install}/setup.bash" ]; then
    . "$_top/${INSTALL_BASE:-install}/setup.bash"
    PATH="$_top/${INSTALL_BASE:-install}/homography_servo/lib/homography_servo:$PATH"
fi
unset _top
