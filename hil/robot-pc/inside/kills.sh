# SIGKILL and SIGSTOP at random moments of a motion. Sourced by checks.sh.
pause() { sleep "$(printf '0.%03d' $((RANDOM % 900)))"; }

worst_daemon=0 worst_estimator=0 still=0 tried=0
for round in $(seq "$ROUNDS"); do
    is progress driving || { operator command start >/dev/null; within 20000 is phase excite >/dev/null; }
    pause
    old=$(pid_of plumbline-estimator)
    kill -KILL "$old"
    took=$(within 5000 other_pid plumbline-estimator "$old")
    [ "$took" -gt $worst_estimator ] && worst_estimator=$took
    is phase stopped && say "round $round: the arm stopped with the estimator"
    pause
    old=$(pid_of plumbline)
    kill -KILL "$old"
    took=$(within 8000 up_again "$old")
    [ "$took" -gt $worst_daemon ] && worst_daemon=$took
    # For a second and more the new daemon only holds.
    tried=$((tried + 1))
    sleep 1.2
    holds && still=$((still + 1))
done
limit=$((2 * PATIENCE))
check "$ROUNDS killed estimators: the next one is up within $limit s" "worst $worst_estimator ms" test "$worst_estimator" -lt ${limit}000
check "$ROUNDS killed daemons: the next one answers within $limit s" "worst $worst_daemon ms" test "$worst_daemon" -lt ${limit}000
check "$ROUNDS killed daemons: the next one only holds" "$still of $tried" test "$still" = "$tried"
uid=$(id -u plumbline)
running=$(find /run/plumbline/iceoryx2/nodes -maxdepth 1 -name '*.node_monitor' | wc -l)
check "nothing stale is left" "$running nodes, $(find /dev/shm -name "plumbline_${uid}_*" | wc -l) segments" test "$running" -le 4
