"""Recording to run folder, stage by stage; each stage reads and writes named artefacts, so any can run again alone."""
