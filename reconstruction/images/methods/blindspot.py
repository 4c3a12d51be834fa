"""Blind-spot network: learns from spikes alone, so also from a recording whose true light nobody knows.

Order: as Spk2ImgNet, a little less sharp. It has learnt to guess each pixel's interval from its neighbours and from the
pixel's own past and future, and joins the guess with the interval as far as their errors tell. The weights that ship
come from the spikes of random scenes; `python -m reconstruction.networks.train own REC --out DIR` trains on REC.
Cost: about a second a core at 400x250. Sources: `reconstruction.networks.blind_spot`.
"""

from functools import partial

from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.learned import learned

METHOD = ImageMethod("blindspot", partial(learned, "blindspot"), price_s=0.72, learned=True)
