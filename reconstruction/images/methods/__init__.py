"""The methods that turn spikes into images, one file each; `reconstruction.images.catalogue` lists them."""
