"""The paper's networks by its text: encoder, covariance regressor, source count, FAF.

Shapes are for N microphones, F = 257 bins and L = 64 frames. The outputs of ``CovarianceNetwork``
and ``SourceCountNetwork`` are real, so that both export to ONNX; EVD and MUSIC stand between them
and ``FrequencyAttentionFusion`` (``model_export.training.regression``).
"""

NUM_BINS = 257
NUM_FRAMES = 64
LATENT = 64
"""D, covariance features per bin: the 16 x 4 cells that four poolings leave of 257 x 64"""
