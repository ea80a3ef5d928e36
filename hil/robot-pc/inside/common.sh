# What the checks inside the virtual robot PC share. Every check ends in one line of a table:
#   HELD <tab> what <tab> measured        or        FAILED <tab> what <tab> what was there instead
# On the console and in the log it ends with the seconds since the line before.
TABLE=${TABLE:-/var/lib/robot-pc/table.tsv}
mkdir -p "$(dirname "$TABLE")"

LOG=$(dirname "$TABLE")/log
# To a file, which a container's owner reads, and to the console, which a virtual machine's owner sees.
say() {
    printf '%s\n' "$*" >>"$LOG"
    { printf '%s\n' "$*" >/dev/console; } 2>/dev/null || true
}
ms() { echo $((${EPOCHREALTIME/[.,]/} / 1000)); }
LAST=$(ms)
row() {
    local now took
    now=$(ms); took=$((now - LAST)); LAST=$now
    printf '%s\t%s\t%s\n' "$1" "$2" "$3" >>"$TABLE"
    say "$(printf '%-7s %-62s %s [%d.%d s]' "$1" "$2" "$3" $((took / 1000)) $((took % 1000 / 100)))"
}

# check WHAT MEASURED COMMAND...: held when the command succeeds.
check() {
    local what=$1 measured=$2
    shift 2
    if "$@"; then row HELD "$what" "$measured"; else row FAILED "$what" "$measured"; fi
}

# What a form of this machine can't show; said, so that nobody takes it for held.
not_shown() { row "NOT SHOWN HERE" "$1" "$2"; }

# How many times longer than on a robot's PC everything may take.
PATIENCE=${PATIENCE:-1}
# within MS COMMAND...: tries for PATIENCE times as long, every POLL seconds, until it succeeds; prints the milliseconds that it took.
POLL=${POLL:-0.02}
within() {
    local limit=$(($1 * PATIENCE)) start now
    shift
    start=$(ms)
    until "$@"; do
        now=$(ms)
        if [ $((now - start)) -gt "$limit" ]; then echo $((now - start)); return 1; fi
        sleep $POLL
    done
    echo $(($(ms) - start))
}

# setpriv: runuser opens a session each time, which takes an emulated processor a second.
as() { local user=$1; shift; setpriv --reuid="$user" --regid="$user" --init-groups "$@"; }
operator() { PLUMBLINE_RUNTIME_DIR=/run/plumbline timeout $((20 * PATIENCE)) setpriv --reuid=plumbline --regid=plumbline --init-groups plumbline "$@"; }
status() { operator command status --json 2>/dev/null; }
# field NAME: the first value of that name in the daemon's status; fields NAME...: several of one status, with a blank between.
field() { fields "$1"; }
fields() {
    local all name values=()
    all=$(status)
    for name in "$@"; do
        local pattern='"'$name'": ("([^"]*)"|([^",]+))'
        if [[ ${all//$'\n'/,} =~ $pattern ]]; then values+=("${BASH_REMATCH[2]}${BASH_REMATCH[3]}"); else values+=(""); fi
    done
    echo "${values[*]}"
}
is() { [ "$(field "$1")" = "$2" ]; }
holds() { [ "$(fields phase progress motion)" = "hold idle 0" ]; }
pid_of() { systemctl show --property=MainPID --value "$1"; }
other_pid() { local now; now=$(pid_of "$1"); [ "$now" != 0 ] && [ "$now" != "$2" ]; }
answers() { [ -n "$(status)" ]; }
up_again() { other_pid plumbline "$1" && answers; }
loop_of() { grep -l '^plumbline-loop' /proc/"$1"/task/*/comm | sed 's|.*task/\([0-9]*\)/.*|\1|'; }
# What the services have said since the last `mark`.
MARK=
mark() { MARK=$(journalctl --no-pager --quiet -n 0 --show-cursor | sed -n 's/^-- cursor: //p'); }
journal() { journalctl --sync; journalctl -u plumbline -u plumbline-estimator --no-pager -o cat ${MARK:+--after-cursor="$MARK"}; }
journal_says() { journal | grep -qF -- "$1"; }
