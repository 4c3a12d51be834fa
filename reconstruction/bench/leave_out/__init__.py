"""A plan beside a run that leaves out nothing."""
