# Print a Python of the wanted version, or the default one where there is none.
set -u
for python in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$1"*/bin/python "$HOME"/.local/share/uv/python/cpython-"$1"*/bin/python; do
    if "$python" -c 'import ensurepip' 2> /dev/null; then
        echo "$python"
        exit 0
    fi
done
echo "no Python $1 here; using the default one" >&2
echo python3
