"""A recording on disk: manifest, writer, reader, verification, import."""
