"""Who runs the cells of a campaign: the processes of this machine, or the workers of a cluster."""
