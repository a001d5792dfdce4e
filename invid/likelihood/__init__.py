"""Structured errors-in-variables maximum likelihood on the missing torque."""
