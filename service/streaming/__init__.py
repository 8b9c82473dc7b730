"""Streams: a session as a state machine without I/O, and what it computes with.

The way of the audio: ``intake`` (whole sample frames) → ``buffer`` (bounded, oldest dropped) →
``pipeline`` (samples, resampling, STFT, localizer, tracker) → ``reporter`` (messages). All but the
pipeline is cheap and runs on the event loop; the pipeline runs in a worker process, one step at a
time, and only looks at the channels (``diagnostics``) in a thread beside it.
"""
