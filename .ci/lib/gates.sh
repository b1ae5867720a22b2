# Headings of gates with the time that each has taken, and a table of all of them at the end. To be sourced.
set -euo pipefail
# Programs are ended by signals. Whoever starts the gates may ignore these, as shells do for what runs in the background, and `nohup` does;
# then programs would, too.
if [ -z "${GATES_HEAR_SIGNALS:-}" ]; then
    exec env --default-signal=INT,HUP GATES_HEAR_SIGNALS=1 "$PWD/.ci/$(basename "$0")" "$@"
fi
# Nothing is compiled twice, so nothing has to be kept for the next time.
export CARGO_INCREMENTAL=0
# Many tests wait, for servers that are silent and for processes that are killed: more run than there are cores. None may mind.
export RUST_TEST_THREADS=$((4 * $(nproc)))
begun=0 heading= table=()
clock() { printf '%d:%02d' $(($1 / 60)) $(($1 % 60)); }
close_gate() {
    [ -z "$heading" ] || table+=("$(printf '%7s  %s' "$(clock $((SECONDS - begun)))" "$heading")")
    begun=$SECONDS
}
# Begins a gate.
gate() {
    close_gate
    heading=$*
    echo "== $(clock $SECONDS) $heading"
}
room() { echo "-- $(df -h --output=avail . | tail -n 1 | tr -d ' ') free, target folders $(du -shc target paper/target 2>/dev/null | tail -n 1 | cut -f 1)"; }
# Prints how long each gate took, however it ended.
times() {
    local code=$?
    close_gate
    printf '%s\n' "${table[@]}"
    echo "$(printf '%7s' "$(clock $SECONDS)")  in all"
    [ $code = 0 ] && echo "== all gates passed" || echo "== stopped in: $heading"
    exit $code
}
trap times EXIT
# Ended from outside is not passed.
trap 'exit 130' INT
trap 'exit 143' TERM
