"""DUSt3R: from pairs of images to points; the user supplies the weights."""
