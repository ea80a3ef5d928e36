#!/usr/bin/env bash
# Arms from public packages: import the URDF, compare with Pinocchio, plan, run in simulation, identify, compare again.
#
#   hil/arms/run.sh [--fast] [NAME...]       names: ur5e iiwa14 xarm7 gen3 fr3; all of them where none is given
#
# --fast stops after the first comparison: no plan, no run. Packages are fetched from PyPI into target/arms (about 360 MB). PROGRAM names
# the program, by default target/release/plumbline, or target/debug/plumbline where that is not built.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=$root/target/arms
program=${PROGRAM:-$root/target/release/plumbline}
[ -x "$program" ] || program=$root/target/debug/plumbline
fast=
if [ "${1:-}" = --fast ]; then fast=yes; shift; fi
names=("$@")
[ $# -gt 0 ] || names=(ur5e iiwa14 xarm7 gen3 fr3)
mkdir -p "$work"
python=$("$root/hil/peers/venv.sh" --in arms 'pin==4.1.0')

# PACKAGE==VERSION ARCHIVE-PREFIX FOLDER-IN-IT URDF-BELOW-IT OPTIONS...
describe() {
    case "$1" in
    ur5e) echo "airo-models==0.0.12 airo_models airo_models/arms/ur5e ur5e.urdf" ;;
    iiwa14) echo "pybullet==3.2.7 pybullet pybullet_data/kuka_iiwa model.urdf" ;;
    xarm7) echo "example-robot-data==6.0.0 example_robot_data cmeel.prefix/share/example-robot-data/robots/xarm_description urdf/xarm7.urdf" ;;
    gen3) echo "rtb-data==1.0.1 rtb-data rtb-data-1.0.1/rtbdata/xacro/kortex_description arms/gen3/7dof/urdf/GEN3_URDF_V12.urdf" ;;
    fr3) echo "franky-sim==1.0.4 franky_sim franky_sim/assets fr3.urdf --tool fr3_hand" ;;
    *) echo "hil/arms/run.sh: no arm \`$1\`: ur5e iiwa14 xarm7 gen3 fr3" >&2; return 2 ;;
    esac
}

failed=0
for name in "${names[@]}"; do
    description=$(describe "$name")
    read -r package archive folder urdf options <<<"$description"
    if [ ! -d "$work/packages/$folder" ]; then
        compgen -G "$work/archives/$archive*" >/dev/null ||
            "$python" -m pip download --quiet --no-deps --dest "$work/archives" "$package" >"$work/pip.log" 2>&1 ||
            { echo "$name: SKIPPED, $package could not be had ($work/pip.log)"; continue; }
        "$python" "$here/unpack.py" "$work/archives/$archive"* "$folder" "$work/packages"
    fi
    out=$work/$name
    rm -rf "$out"
    # shellcheck disable=SC2086 # options are words
    "$program" robot import "$work/packages/$folder/$urdf" --name "$name-urdf" --out "$out" $options >"$out.log" || { cat "$out.log"; failed=1; continue; }
    "$python" "$here/compare.py" "$work/packages/$folder/$urdf" "$out/$name-urdf.toml" "$out/sim-$name-urdf-arm.toml" || failed=1
    [ -n "$fast" ] && continue
    begin=$(date +%s)
    (
        cd "$out"
        "$program" plan --robot "$name-urdf.toml" --mounting wall --starts 8 --rounds 0 --out plan.toml
        # A short search for the motions; two of them of five periods.
        "$program" run "sim-$name-urdf.toml" --out results --set excitation.starts=8 --set excitation.rounds=0
        "$program" export results --out exported
    ) >>"$out.log" 2>&1 || { tail -n 5 "$out.log"; failed=1; continue; }
    grep -E 'base parameters|^diagnosis|^RMS upright' "$out.log" | sed "s/^/$name: /"
    "$python" "$here/compare.py" "$work/packages/$folder/$urdf" "$out/$name-urdf.toml" "$out/exported/$name-urdf.urdf" \
        "$out/results/model.toml" || failed=1
    echo "$name: plan, run and export in $(($(date +%s) - begin)) s"
done
exit $failed
