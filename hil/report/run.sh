#!/usr/bin/env bash
# Looks at report pages in headless Chromium: no console error, nothing wider than the window, no label outside its plot, colours of both
# themes, and a PDF.
#
#   hil/report/run.sh [PAGE.html...]       (a report that the short job of docs/guide/simulation.md makes, and its comparison with itself)
#
# Chromium is Debian's (`apt-get install chromium`), installed here where it is missing and this user may. With KEEP=DIR the pictures stay there.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)
if [ -z "$browser" ]; then
    [ "$(id -u)" = 0 ] || { echo "no chromium: apt-get install chromium" >&2; exit 1; }
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium >/dev/null
    browser=$(command -v chromium)
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
if [ $# = 0 ]; then
    cd "$root"
    # ls fails where one of them is missing.
    program=$({ ls -t target/release/plumbline target/debug/plumbline 2>/dev/null || true; } | head -n 1)
    [ -n "$program" ] || { echo "no program: cargo build" >&2; exit 1; }
    "$program" run config/sim-panda-wall.toml --out "$folder/job" --quiet --set serve.id="report-page-$$" \
        --set excitation.periods=4 --set excitation.starts=4 --set validation.trajectories=2 --set output.dataset=false
    "$program" report "$folder/job" "$folder/job" --out "$folder/compared.html" >/dev/null
    set -- "$folder/job/report.html" "$folder/compared.html"
fi
exec python3 "$here/look.py" "$browser" "${KEEP:-}" "$@"
