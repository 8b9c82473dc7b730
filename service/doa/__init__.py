"""Direction-of-arrival numerics in numpy: no I/O, no framework.

Conventions
-----------
Shape letters: N microphones, M sources, F frequency bins, L frames, A grid angles, B batch or
blocks, T samples. Channels come first.
Units: radians, metres, seconds, hertz. Degrees exist only on the wire and the command line.
Array frame: right-handed, x forward, y left, z up (ROS REP-103). Azimuth runs counter-clockwise
from +x; elevation is above the x-y plane.
Steering: a_n(f, theta) = exp(+j 2 pi f p_n . u(theta) / c) with u pointing towards the source, so a
microphone nearer to the source has the more advanced phase; ||a||^2 = N.
Covariance: R(f) = E[x x^H] with x the (N,) STFT vector of bin f.
Precision: float32 and complex64 at run time.

The steps of the method, in the order in which the audio passes them: ``stft`` (STFT), the encoder
and the regressor or weights network (``service.inference``, ONNX), ``covariance``, ``evd``,
``music``, ``fusion`` (frequency attention fusion, FAF), ``peaks``.
"""
