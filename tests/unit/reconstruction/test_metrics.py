import math

import numpy as np
import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure

from reconstruction.metrics.depth import abs_rel, delta_1_25
from reconstruction.metrics.image import mean_over, psnr_db, ssim_map


def image(seed=0, shape=(40, 56)):
    return np.random.default_rng(seed).random(shape).astype(np.float32) * 0.6


def test_psnr_of_a_known_error():
    truth = image()
    assert psnr_db(truth + 0.06, truth, 0.6) == pytest.approx(20.0, abs=1e-4)


def test_equal_images_have_infinite_psnr_and_ssim_one():
    assert psnr_db(image(), image(), 0.6) == math.inf
    assert mean_over(ssim_map(image(), image(), 0.6), None) == pytest.approx(1.0, abs=1e-6)


def test_a_mask_leaves_the_rest_out():
    truth, mask = image(), np.zeros((40, 56), bool)
    mask[:20] = True
    wrong = truth.copy()
    wrong[20:] += 1
    wrong[:20] += 0.06
    assert psnr_db(wrong, truth, 0.6, mask) == pytest.approx(20.0, abs=1e-4)
    assert math.isnan(psnr_db(wrong, truth, 0.6, np.zeros_like(mask)))


def ssim_by_definition(a, b, white):
    """Wang et al. 2004 at every pixel away from the border: 11 x 11 Gaussian window of sigma 1.5."""
    g = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    w = np.outer(g, g) / np.outer(g, g).sum()
    c1, c2, values = (0.01 * white) ** 2, (0.03 * white) ** 2, []
    for y in range(5, a.shape[0] - 5):
        for x in range(5, a.shape[1] - 5):
            p, q = (i[y - 5 : y + 6, x - 5 : x + 6].astype(np.float64) for i in (a, b))
            mp, mq = (w * p).sum(), (w * q).sum()
            vp, vq, cov = (w * p * p).sum() - mp**2, (w * q * q).sum() - mq**2, (w * p * q).sum() - mp * mq
            values.append((2 * mp * mq + c1) * (2 * cov + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2)))
    return np.mean(values)


def test_ssim_is_the_published_one_away_from_the_border():
    a, b = image(1, (24, 30)), image(2, (24, 30))
    mask = np.zeros((24, 30), bool)
    mask[5:-5, 5:-5] = True
    assert mean_over(ssim_map(a, b, 0.6), mask) == pytest.approx(ssim_by_definition(a, b, 0.6), abs=1e-9)


def test_ssim_is_that_of_torchmetrics_up_to_the_border():
    a, b = image(1), image(2)
    x, y = (torch.from_numpy(i.astype(np.float64))[None, None] for i in (a, b))
    _, full = structural_similarity_index_measure(x, y, sigma=1.5, data_range=0.6, return_full_image=True)
    assert np.abs(ssim_map(a, b, 0.6) - full[0, 0].numpy()).max() < 1e-9


def test_depth_errors_of_a_known_ratio():
    truth = np.full((4, 4), 2.0, np.float32)
    assert abs_rel(truth * 1.1, truth) == pytest.approx(0.1, abs=1e-6)
    assert delta_1_25(truth * 1.2, truth) == 1
    assert delta_1_25(truth * 0.79, truth) == 0


def test_missing_depth_is_left_out_of_abs_rel_and_counts_against_delta():
    truth = np.full((2, 2), 2.0, np.float32)
    depth = truth.copy()
    depth[0] = np.nan
    assert abs_rel(depth, truth) == 0
    assert delta_1_25(depth, truth) == 0.5


def test_no_truth_at_all_is_nan():
    nothing = np.full((2, 2), np.nan, np.float32)
    assert math.isnan(abs_rel(nothing, nothing))
    assert math.isnan(delta_1_25(nothing, nothing))
