"""Light to verified bytes on disk: spikes, scenes, devices, recordings, sessions."""
