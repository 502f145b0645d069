"""The tasks: what is drawn, judged, observed and rewarded, as functions of the `SceneState` of n worlds. No engine."""
