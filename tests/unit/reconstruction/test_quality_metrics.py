import math
import pickle

import cv2
import numpy as np
import pytest
import torch

from reconstruction.errors import BadRunError
from reconstruction.metrics.image import edge_sharpness
from reconstruction.metrics.lpips import Lpips
from reconstruction.metrics.natural import Niqe, brisque, fit_asymmetric, niqe_features


def picture(seed=0, height=200, width=300):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 2) * 0.6


def test_edge_sharpness_is_one_for_truth_and_falls_with_blur_not_with_noise():
    truth = picture()
    noisy = truth + np.random.default_rng(1).normal(0, 0.01, truth.shape).astype(np.float32)
    assert edge_sharpness(truth, truth) == pytest.approx(1)
    assert edge_sharpness(truth / 2, truth) == pytest.approx(0.5)
    assert edge_sharpness(noisy, truth) == pytest.approx(1, abs=0.05)
    blurred = [edge_sharpness(cv2.GaussianBlur(truth, (0, 0), s), truth) for s in (1, 2, 4)]
    assert 1 > blurred[0] > blurred[1] > blurred[2] > 0
    assert edge_sharpness(np.zeros_like(truth), truth) == 0


def test_edge_sharpness_looks_at_the_mask_alone():
    truth, mask = picture(), np.zeros((200, 300), bool)
    mask[50:100, 50:100] = True
    broken = truth.copy()
    broken[120:] = 0
    assert edge_sharpness(broken, truth, mask) == pytest.approx(1)
    assert math.isnan(edge_sharpness(truth, truth, np.zeros_like(mask)))
    assert math.isnan(edge_sharpness(truth, np.ones_like(truth)))


@pytest.fixture
def alexnet(tmp_path):
    """Weights of AlexNet's shapes, drawn at random: LPIPS' own are not in the repository."""
    torch.manual_seed(0)
    shapes = {0: (64, 3, 11, 11), 3: (192, 64, 5, 5), 6: (384, 192, 3, 3), 8: (256, 384, 3, 3), 10: (256, 256, 3, 3)}
    weights = {f"features.{n}.weight": torch.randn(s) * math.sqrt(2 / math.prod(s[1:])) for n, s in shapes.items()}
    torch.save(weights | {f"features.{n}.bias": torch.zeros(s[0]) for n, s in shapes.items()}, tmp_path / "alexnet.pth")
    return tmp_path / "alexnet.pth"


def test_lpips_is_zero_for_equal_images_and_grows_with_the_difference(alexnet):
    distance, image = Lpips(alexnet), picture() / np.float32(0.6)
    noise = np.random.default_rng(2).normal(0, 1, image.shape).astype(np.float32)
    assert distance(image, image) == 0
    little, much = (distance(image + s * noise, image) for s in (0.02, 0.2))
    assert 0 < little < much
    assert distance(image, image + 0.02 * noise) == pytest.approx(little, rel=1e-5)


def test_lpips_reads_tensors_only(tmp_path, alexnet):
    class Code:
        def __reduce__(self):
            return (print, ("run",))

    (tmp_path / "code.pth").write_bytes(pickle.dumps(Code(), protocol=2))
    torch.save({"features.0.weight": torch.zeros(1)}, tmp_path / "other.pth")
    (tmp_path / "cut.pth").write_bytes(alexnet.read_bytes()[:1000])
    for name in ("code.pth", "other.pth", "cut.pth", "absent.pth"):
        with pytest.raises(BadRunError, match=f"{name}: found no weights of AlexNet"):
            Lpips(tmp_path / name)


@pytest.mark.parametrize("shape", [0.8, 2.0, 4.0])
def test_the_asymmetric_gaussian_is_found_again(shape):
    rng = np.random.default_rng(0)
    size = rng.gamma(1 / shape, 1, 200_000) ** (1 / shape)
    values = np.where(rng.random(200_000) < 1 / 3, -size, 2 * size)  # widths 1 and 2 have weights 1 and 2
    found, left, right = fit_asymmetric(values)
    assert found == pytest.approx(shape, rel=0.05)
    assert left == pytest.approx(1, rel=0.05)
    assert right == pytest.approx(2, rel=0.05)


def eight_bit(image):
    return np.round(np.clip(image / 0.6, 0, 1) * 255).astype(np.uint8)


def test_niqe_is_small_on_its_own_kind_and_grows_with_noise(tmp_path):
    pristine = np.concatenate([niqe_features(eight_bit(picture(s, 400, 500))) for s in range(4)])
    assert pristine.shape == (4 * 20, 36)
    model = {"mu_pris_param": pristine.mean(axis=0)[None], "cov_pris_param": np.cov(pristine, rowvar=False)}
    np.savez(tmp_path / "niqe.npz", **model)
    niqe, image = Niqe(tmp_path / "niqe.npz"), picture(9, 400, 500)
    noise = np.random.default_rng(1).normal(0, 0.05, image.shape)
    assert niqe(eight_bit(image)) < niqe(eight_bit(image + noise)) < niqe(eight_bit(image + 3 * noise))
    assert math.isnan(niqe(eight_bit(picture(1, 97, 100))))
    assert math.isnan(niqe(eight_bit(picture(1, 40, 50))))
    assert math.isnan(niqe(np.zeros((200, 300), np.uint8)))


def test_niqe_refuses_what_is_no_model(tmp_path):
    np.savez(tmp_path / "small.npz", mu_pris_param=np.zeros(18), cov_pris_param=np.zeros((18, 18)))
    np.savez(tmp_path / "other.npz", mean=np.zeros(36))
    (tmp_path / "text.npz").write_text("nothing")
    for name in ("small.npz", "other.npz", "text.npz", "absent.npz"):
        with pytest.raises(BadRunError, match=f"{name}: found no NIQE model"):
            Niqe(tmp_path / name)


def test_brisque_reads_the_parameters_it_is_given(tmp_path):
    """A model trained here on noise: the score is that of the same regression on OpenCV's own features."""
    clean = [eight_bit(picture(s)) for s in range(12)]
    level = np.linspace(0, 0.2, 12)
    noisy = [eight_bit(picture(s) + np.random.default_rng(s).normal(0, v, (200, 300))) for s, v in enumerate(level)]
    features = np.concatenate([cv2.quality.QualityBRISQUE_computeFeatures(p) for p in clean + noisy])
    low, high = features.min(axis=0), features.max(axis=0)
    scaled = (2 * (features - low) / (high - low) - 1).astype(np.float32)
    svm = cv2.ml.SVM_create()
    svm.setType(cv2.ml.SVM_EPS_SVR)
    svm.setKernel(cv2.ml.SVM_RBF)
    svm.setGamma(0.05)
    svm.setC(100)
    svm.setP(0.01)
    svm.train(scaled, cv2.ml.ROW_SAMPLE, np.concatenate([np.zeros(12), level * 100]).astype(np.float32))
    svm.save(str(tmp_path / "model.yml"))
    spans = cv2.FileStorage(str(tmp_path / "range.yml"), cv2.FILE_STORAGE_WRITE)
    spans.write("range", np.stack([low, high]).astype(np.float32))
    spans.release()
    scores = [brisque(p, tmp_path / "model.yml", tmp_path / "range.yml") for p in (clean[0], noisy[5], noisy[11])]
    assert scores[0] < scores[1] < scores[2]


def test_brisque_without_a_model_says_so(tmp_path):
    (tmp_path / "model.yml").write_text("nothing")
    with pytest.raises(BadRunError, match=r"model.yml: found no BRISQUE model"):
        brisque(eight_bit(picture()), tmp_path / "model.yml", tmp_path / "range.yml")
