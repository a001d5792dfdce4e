"""What the service itself says, by stable codes: a sentence, and the way out where there is one."""

from __future__ import annotations

from typing import Any

from invid.wording.sentence import marked, sentence

Saying = tuple[str, str]
"""Templates of what is said and of the way out."""

REASONS: dict[str, Saying] = {
    "run_in_progress": (
        marked("Measurement {run} is under way."),
        marked("wait until it has ended, or cancel it"),
    ),
    "disk_full": (
        marked("The service's disk has {free} MB left, a run needs {needed} MB."),
        marked("delete old files on that disk, or keep results for a shorter time"),
    ),
    "store_unavailable": (
        marked("The store does not answer: a result could not be kept."),
        marked("look at the database and the disk of the service"),
    ),
    "bus_missing": (
        marked("This computer has no CAN interface {channel}."),
        marked("plug the adapter in, then: ip link set {channel} up type can bitrate {bitrate}"),
    ),
    "nothing_to_screen": (
        marked("A short check compares with the accepted model, and there is none yet."),
        marked("measure it in full and accept the result first"),
    ),
    "no_model": (
        marked("A real cell is simulated with its accepted model, and it has none yet."),
        marked("measure it in full and accept the result first"),
    ),
    "shutting_down": (
        marked("The service is shutting down."),
        marked("wait for its restart"),
    ),
    "axes_left_out": (
        marked("{axes} would be held and not shaken: without it no model can be found."),
        marked("choose all axes"),
    ),
    "check_refused": (
        marked("The check refuses this cell: {text}."),
        marked("mend what it says, then ask the drives again (`invid check` does, too)"),
    ),
}
"""Why a cell cannot start."""

NOTES: dict[str, Saying] = {
    "limit_beyond_drive": (
        marked(
            "The torque limit of axis {axis} is {limit} {unit}, {times} times the rated {rated} "
            "{unit}: more than its drive gives."
        ),
        marked("correct the limit or its unit in the config; the drive's own limit holds where it is lower"),
    ),
    "drives_not_asked": (
        marked("Nobody has asked the drives since this service knows them."),
        marked("ask the drives; a measurement asks them before anything moves"),
    ),
}
"""What keeps nothing from starting and must be known."""

ERRORS: dict[str, Saying] = {
    "config": (
        marked("The cell's settings cannot be used."),
        marked("correct the cell's settings"),
    ),
    "recording": (
        marked("The recording cannot be used."),
        marked("check the file"),
    ),
    "not-identifiable": (
        marked("The data do not carry a model."),
        marked("measure longer, more strongly or on more axes"),
    ),
    "safety-stop": (
        marked("It stopped itself for safety."),
        marked("look at the robot, clear the cause that is named, then start again"),
    ),
    "drive": (
        marked("A drive failed, or cannot do the job."),
        marked("look at the drive's display and cable, then start again"),
    ),
    "bus": (
        marked("The CAN bus failed."),
        marked("check the CAN adapter, its cable and its termination, then start again"),
    ),
    "out-of-memory": (
        marked("The data need more memory than one run may take."),
        marked("cut the recording into shorter ones"),
    ),
    "internal-error": (
        marked("An error of the service."),
        marked("report it, with the log of the service"),
    ),
    "stopped": (
        marked("Stopped on request."),
        marked("start again when the cell is clear"),
    ),
    "cancelled": (
        marked("Cancelled on request."),
        marked("start again at any time"),
    ),
    "interrupted": (
        marked("The service ended while this run was at “{state}”; it is not run again."),
        marked(
            "look at the robot, then start a new measurement; what was measured until then is kept "
            "as this run's recording"
        ),
    ),
    "runner-died": (
        marked("The process of the run ended without a result (status {status})."),
        marked("start again; the log of the service says more"),
    ),
    "not-stopped": (
        marked("The process of the run did not stop within {seconds} s and was killed."),
        marked("start again; the log of the service says more"),
    ),
    "store-unavailable": (
        marked("The results could not be stored."),
        marked("look at store and disk: what was measured is kept, and stored as soon as they take it"),
    ),
    "disk-full": (
        marked("The disk of the service is full ({free}); what was measured is kept."),
        marked("make room on it: what was measured is kept, and stored as soon as there is room"),
    ),
    "timeout": (
        marked("It stayed at “{state}” for {seconds} s and was ended."),
        marked("start again; the log of the service says more"),
    ),
}
"""Why a run ended early."""

ACTIONS = {
    "gentler": marked("Start again with half of the torque and half of the motion."),
    "as_planned": marked("Start again as planned: friction alone may hold the axis at such small torques."),
    "start_again": marked("Start again when the cell is clear."),
    "lower_amplitude": marked(
        "It went too far with less torque already: halve the shaking in the cell's settings, "
        "then start again."
    ),
    "free_axis": marked(
        "See that the brake opens, and turn the axis by hand with its drive off. If it turns "
        "freely, friction is above the torque it is shaken with."
    ),
    "clear_axis": marked(
        "See whether the axis has hit something, its brake has closed or its encoder hangs."
    ),
    "rated_torque": marked("Compare the rated torque in the cell's settings with the motor's plate."),
    "scales": marked("Compare rated torque and counts of a turn in the drive with motor, encoder and gear."),
    "signs": marked(
        "Torque and encoder disagree in sign: have two motor phases swapped, or the encoder "
        "inverted in the drive."
    ),
    "torque_scale": marked(
        "Compare the drive's rated torque (0x6076) and rated current (0x6075) with the motor's "
        "plate: one of them is wrong."
    ),
    "sign_turned": marked(
        "Have found out what has turned in motor, encoder or drive before anything moves again."
    ),
    "see_signs": marked(
        "See whether somebody pushes the axis; if nobody does, a sign is wrong in its drive: "
        "have it looked at before it moves again."
    ),
    "see_load": marked(
        "See whether somebody moves the axis or its load is beyond its torque limit; support "
        "the load, then start again."
    ),
    "torque_hidden": marked("Let the drive report its torque; without it nothing can be identified."),
    "no_torque": marked("The drive gives no torque: look at safe torque off and at its current limit."),
    "hold": marked("Let the drives hold the held axes (the cell's settings)."),
    "free_computer": marked("Stop other programs on the service's computer, then start again."),
    "check_encoder": marked("Look at the encoder, its cable and its shield."),
    "check_cable": marked("Check the cable and the supply of the drive."),
    "read_drive": marked("Read the error on the drive and reset it there."),
    "check_bus": marked("Check the CAN adapter, its cable and its termination."),
    "look": marked("Look at the robot, clear what is named above, then start again."),
}
"""The one thing to do after a stop."""

HALTS = {
    "position_window": marked("The axis went further than it may."),
    "velocity": marked("The axis was faster than it may be."),
    "torque": marked("The drive gave more torque than it was asked for."),
    "stands": marked("The axis did not move under its torque."),
    "halted": marked("The axis stopped moving though it was shaken."),
    "scales": marked("Torque and motion do not fit the axis: a scale is wrong."),
    "signs": marked("Torque and encoder disagree in sign."),
    "torque_scale": marked("Measured and commanded torque differ: a rated value in the drive is wrong."),
    "disobeys": marked("The axis moved as its torque had it and now goes the opposite way."),
    "torque_turned": marked(
        "The torque that the drive shows followed the one it is asked for and is now opposed to it."
    ),
    "torque_hidden": marked("The drive does not show its torque."),
    "no_torque": marked("The drive gives no torque."),
    "leapt": marked("The encoder of an axis leapt."),
    "hold_unstable": marked("A held axis began to swing."),
    "yields": marked("An axis went faster and faster against its torque."),
    "not_held": marked("An axis moved though its drive was to hold it at rest."),
    "computer_late": marked("The computer was too late for the drives."),
    "no_answer": marked("The drive did not answer."),
    "drive_left": marked("The drive left operation by itself."),
    "drive_fault": marked("The drive reported a fault."),
    "bus": marked("The CAN bus failed."),
    "asked": marked("Stopped on request."),
}
"""What stopped a motion, in general."""

PROBLEMS = {
    "bad-request": marked("The request cannot be read"),
    "key-missing": marked("A key is needed"),
    "key-invalid": marked("The key is not valid"),
    "scope-missing": marked("The key does not allow this"),
    "foreign-origin": marked("Requests from other web sites are refused"),
    "not-found": marked("There is no such thing"),
    "cell-not-found": marked("There is no such cell"),
    "identification-not-found": marked("There is no such identification"),
    "model-not-found": marked("There is no such model"),
    "parameter-not-found": marked("There is no such parameter or cause"),
    "artefact-not-found": marked("This result does not exist (yet)"),
    "method-not-allowed": marked("This address does not take this method"),
    "run-in-progress": marked("Another identification is in progress on this cell"),
    "not-ready": marked("The cell cannot start"),
    "wrong-state": marked("Not possible in this state"),
    "override-needed": marked("This result is not to be trusted"),
    "nothing-to-separate": marked("There is nothing to separate"),
    "not-simulated": marked("The cell has hardware behind it"),
    "not-tunable": marked("No values for the drives can be given"),
    "no-comparison": marked("There are not two models to compare"),
    "artefact-expired": marked("This file was deleted after its time of retention"),
    "length-required": marked("The size must be given"),
    "too-large": marked("The body is too large"),
    "unsupported-media-type": marked("This kind of body is not taken"),
    "invalid-request": marked("The request holds a value that cannot be used"),
    "invalid-recording": marked("The upload is not a recording"),
    "idempotency-key-reused": marked("The Idempotency-Key was used with another body"),
    "upload-stalled": marked("The upload stalled"),
    "internal-error": marked("An error of the service"),
    "store-unavailable": marked("The store does not answer"),
    "disk-full": marked("There is no room to store this"),
}
"""Titles of problem documents."""

SEE_MANUAL = marked("see the manual")
UNSEEN = marked("Nobody saw its axes at rest: unknown, look.")
LOOK = marked("look at the robot: make sure that every axis stands, and is off or held; then start again")
STATES = {
    "queued": marked("queued"),
    "checking": marked("checking"),
    "awaiting_arm": marked("awaiting_arm"),
    "running": marked("running"),
    "analysing": marked("analysing"),
    "awaiting_accept": marked("awaiting_accept"),
}
"""States in which a run may be cut off."""


def told(saying: Saying, **values: str) -> dict[str, Any]:
    """Return what is said: its ``text``, and the way out (``fix``)."""
    return {"text": sentence(saying[0], **values), "fix": sentence(saying[1], **values)}


def error_of(code: str, **values: str) -> dict[str, Any]:
    """Return why a run ended early, of which the service itself knows all."""
    said = {name: sentence(STATES[v]) if v in STATES else v for name, v in values.items()}
    return {"code": code, **told(ERRORS[code], **said)}
