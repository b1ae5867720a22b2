# Packages of Python. To be sourced.

# install_packages ENVIRONMENT PACKAGE… installs packages into a virtual environment, by uv, which takes a twentieth of pip's time;
# by pip where uv cannot be had or fails.
install_packages() {
    local environment=$1
    shift
    if [ -x "$environment/bin/uv" ] || "$environment/bin/pip" install --quiet uv; then
        "$environment/bin/uv" pip install --quiet --python "$environment/bin/python" "$@" && return
    fi
    "$environment/bin/pip" install --quiet "$@"
}
