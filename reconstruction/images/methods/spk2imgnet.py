"""Spk2ImgNet: a convolutional network trained on random scenes, whose truth is exact.

Order: sharp under motion and quiet where nothing moves, because it has learnt how long to look at each pixel. It looks
64 planes to either side; beyond the ends of a stream it sees the mirror image. Cost: about a second a core at 400x250.
Not for radiometry outside its training: it was trained on 0.01 to 0.95 spikes a tick and up to half a pixel a tick.
Two sizes: `small` (0.2 M parameters, ours, without alignment) has weights that ship; `published` (3.9 M, the paper's)
has none, and can be trained by `python -m reconstruction.networks.train network published --device cuda`.
Source: Zhao et al., "Spk2ImgNet: learning to reconstruct dynamic scene from continuous spike stream", CVPR 2021.
"""

from functools import partial

from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.learned import learned

METHOD = ImageMethod("spk2imgnet", partial(learned, "small"), price_s=0.48, learned=True)
