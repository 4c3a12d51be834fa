"""Networks that turn spikes into images: what they see, how they are built, trained, stored and run."""
