"""The export formats, one file each; `reconstruction.export.catalogue` lists them."""
