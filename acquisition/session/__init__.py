"""One armed run of a whole rig: arm, trigger, record, close."""
