# What the checks inside the virtual robot PC share. Every check ends in one line of a table:
#   HELD <tab> what <tab> measured        or        FAILED <tab> what <tab> what was there instead
TABLE=${TABLE:-/var/lib/robot-pc/table.tsv}
mkdir -p "$(dirname "$TABLE")"

LOG=$(dirname "$TABLE")/log
# To a file, which a container's owner reads, and to the console, which a virtual machine's owner sees.
say() {
    printf '%s\n' "$*" >>"$LOG"
    { printf '%s\n' "$*" >/dev/console; } 2>/dev/null || true
}
row() { printf '%s\t%s\t%s\n' "$1" "$2" "$3" >>"$TABLE"; say "$(printf '%-7s %-62s %s' "$1" "$2" "$3")"; }

# check WHAT MEASURED COMMAND...: held when the command succeeds.
check() {
    local what=$1 measured=$2
    shift 2
    if "$@"; then row HELD "$what" "$measured"; else row FAILED "$what" "$measured"; fi
}

# What a form of this machine can't show; said, so that nobody takes it for held.
not_shown() { row "NOT SHOWN HERE" "$1" "$2"; }

ms() { date +%s%3N; }
# within MS COMMAND...: tries until it succeeds; prints the milliseconds that it took.
within() {
    local limit=$1 start now
    shift
    start=$(ms)
    until "$@"; do
        now=$(ms)
        if [ $((now - start)) -gt "$limit" ]; then echo $((now - start)); return 1; fi
        sleep 0.02
    done
    echo $(($(ms) - start))
}

operator() { runuser -u plumbline -- env PLUMBLINE_RUNTIME_DIR=/run/plumbline plumbline "$@"; }
status() { operator command status 2>/dev/null; }
# field NAME: the first value of that name in the daemon's status.
field() { status | sed -n "s/^ *\"$1\": \"\{0,1\}\([^\",]*\)\"\{0,1\},\{0,1\}\$/\1/p" | head -n 1; }
is() { [ "$(field "$1")" = "$2" ]; }
pid_of() { systemctl show --property=MainPID --value "$1"; }
other_pid() { local now; now=$(pid_of "$1"); [ "$now" != 0 ] && [ "$now" != "$2" ]; }
answers() { [ -n "$(status)" ]; }
up_again() { other_pid plumbline "$1" && answers; }
# What the services have said since the last `mark`.
MARK=
mark() { MARK=$(journalctl --no-pager --quiet -n 0 --show-cursor | sed -n 's/^-- cursor: //p'); }
journal() { journalctl --sync; journalctl -u plumbline -u plumbline-estimator --no-pager -o cat ${MARK:+--after-cursor="$MARK"}; }
journal_says() { journal | grep -qF -- "$1"; }
