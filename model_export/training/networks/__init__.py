"""The paper's networks, as its text has them: encoder, covariance regressor, source count, FAF.

Shapes for N microphones, F = 257 bins and L = 64 frames. What leaves ``CovarianceNetwork`` and
``SourceCountNetwork`` is real, so that both export to ONNX; EVD and MUSIC stand between them and
``FrequencyAttentionFusion`` (``model_export.training.regression``).
"""

NUM_BINS = 257
NUM_FRAMES = 64
LATENT = 64
"""D, covariance features per bin: what four poolings leave of 257 x 64 cells, 16 x 4"""
