#!/bin/sh
# The league's records that `invid fetch-data` does not bring, from a folder of clones (bare ones too) named OWNER+NAME/repo:
#   league_data.sh TO CLONES
# Licences: torque_limited_simple_pendulum and acromonk BSD-3-Clause, Robot_Identification MIT, FrankaEmikaPandaDynModel GPL-3.0;
# HSM150-data, dynamic_calibration, figaroh-examples, Friction-Identification-for-Manipulators and robot_identification state none:
# cite, do not ship.
set -eu
to=$1
clones=$2
mkdir -p "$to/simple_pendulum" "$to/hsm150" "$to/panda" "$to/ur10e" "$to/tiago" "$to/tx40" "$to/openarm" \
    "$to/kr300_abc" "$to/acromonk" "$to/six_axis"
show() { git -C "$clones/$1/repo" show "HEAD:$2"; }
pendulum=dfki-ric-underactuated-lab+torque_limited_simple_pendulum
for method in ddp direct_collocation ilqr; do
    show $pendulum "results/control_method_$method/data_measured.csv" > "$to/simple_pendulum/$method.csv"
done
show $pendulum results/control_method_pd/system_identification/data_measured.csv > "$to/simple_pendulum/pd_id.csv"
for run in pos_0.065_1 pos_0.065_2 pos_0.06_1; do
    show malik-robert+HSM150-data "Data/Identification/idf_$run.mat" > "$to/hsm150/idf_$run.mat"
done
log=matlab/data/Exciting_Traj/Trajectory_1/rbt_log/exciting_traj
panda=marcocognetti+FrankaEmikaPandaDynModel
work=$(mktemp -d)
show $panda "${log}_time.txt" > "$work/time"
for what in position:positions torque:torques; do
    show $panda "${log}_${what#*:}.txt" | awk 'NR % 7 == 0' > "$work/${what%:*}"
done
{ echo time,position,torque; paste -d, "$work/time" "$work/position" "$work/torque"; } > "$to/panda/joint_7.csv"
for number in 1 2 3; do
    for what in theta torque; do
        for joint in 1 2 3 4 5 6; do
            show Naruton94+robot_identification "matlab_identification/data/DataOutput_Traj$number/DataOutput_$what$joint.txt" |
                sed -n 's/.*:=\([-0-9.eE]*\)F.*/\1/p' > "$work/$what$joint"
        done
    done
    { echo q1,q2,q3,q4,q5,q6,u1,u2,u3,u4,u5,u6; paste -d, "$work"/theta? "$work"/torque?; } > "$to/six_axis/trajectory_$number.csv"
done
rm -r "$work"
for letter in A B C; do
    show JonasWeigand+Robot_Identification "data/recorded_trajectories/2020-10-21 10s FF $letter 08ms/data.mat" \
        > "$to/kr300_abc/$letter.mat"
done
for run in BF_pd_5x BF_tvlqr_5x; do
    show dfki-ric-underactuated-lab+acromonk "results/real_system/csvs/$run.csv" > "$to/acromonk/$run.csv"
done
for joint in 1 2 3 4 5 6; do
    show shamilmamedov+dynamic_calibration "dataset_ur10e/jointwise_motion/ur-20_01_22-joint_$joint.csv" \
        > "$to/ur10e/joint_$joint.csv"
done
figaroh=thanhndv212+figaroh-examples
for what in position effort; do
    show $figaroh "examples/tiago/data/identification/dynamic/tiago_$what.csv" > "$to/tiago/tiago_$what.csv"
done
for what in curr pos_read; do
    show $figaroh "examples/staubli_TX40/data/${what}_data.csv" > "$to/tx40/${what}_data.csv"
done
for joint in 1 3 4 6 7; do
    show YIZHIXIAOCANGSHU+Friction-Identification-for-Manipulators \
        "results/real_uart_capture_collect_joint_$joint.npz" > "$to/openarm/joint_$joint.npz"
done
