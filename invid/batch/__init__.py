"""Many recordings analysed: on this machine or on a cluster, resumable."""
