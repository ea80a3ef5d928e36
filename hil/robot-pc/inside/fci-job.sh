# The main job over FCI, shortened: fci_job PERIODS prints its arguments. Sourced here and on the host, which plans for a slow machine. It bears as many lost
# states in a row as the robot bears commands: stalls of this machine are not what is tried.
fci_job() {
    printf '%s\n' --set backend.franka.address=172.16.0.2 --set "excitation.period=3 s" --set "excitation.periods=$1" --set excitation.starts=1 \
        --set excitation.rounds=0 --set validation.trajectories=1 --set diagnosis.enabled=false --set safety.max-lost=19
}
