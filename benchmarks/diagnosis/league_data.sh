#!/bin/sh
# The league's records that `invid fetch-data` does not bring, from clones of their repositories:
#   league_data.sh TO PENDULUM HSM150 PANDA
# github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum (BSD-3-Clause), malik-robert/HSM150-data (no
# licence stated), marcocognetti/FrankaEmikaPandaDynModel (GPL-3.0). Clones may be bare.
set -eu
to=$1
mkdir -p "$to/simple_pendulum" "$to/hsm150" "$to/panda"
for method in ddp direct_collocation ilqr; do
    git -C "$2" show "HEAD:results/control_method_$method/data_measured.csv" > "$to/simple_pendulum/$method.csv"
done
git -C "$2" show HEAD:results/control_method_pd/system_identification/data_measured.csv > "$to/simple_pendulum/pd_id.csv"
for run in pos_0.065_1 pos_0.065_2 pos_0.06_1; do
    git -C "$3" show "HEAD:Data/Identification/idf_$run.mat" > "$to/hsm150/idf_$run.mat"
done
log=matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj
joint() { git -C "$1" show "HEAD:${log}_$2.txt" | awk 'NR % 7 == 0'; }
work=$(mktemp -d)
git -C "$4" show "HEAD:${log}_time.txt" > "$work/time"
joint "$4" positions > "$work/position"
joint "$4" torques > "$work/torque"
{ echo time,position,torque; paste -d, "$work/time" "$work/position" "$work/torque"; } > "$to/panda/joint_7.csv"
rm -r "$work"
