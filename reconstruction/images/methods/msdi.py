"""MSDI's image network on a single stream: the small Spk2ImgNet, trained further beside MSDI's geometry.

Order and cost are those of `spk2imgnet`, whose weights it started from. Source: `reconstruction.networks.msdi.network`.
"""

from functools import partial

from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.learned import learned

METHOD = ImageMethod("msdi", partial(learned, "msdi"), price_s=0.48, learned=True)
