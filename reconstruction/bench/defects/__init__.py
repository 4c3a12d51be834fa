"""Each defect of real cameras and light, with its cure and without."""
