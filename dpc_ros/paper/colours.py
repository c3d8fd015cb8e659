"""The colour of each model in the figures of the experiments (Okabe and Ito)."""

COLOURS = {
    'flat': '#0072b2',
    'graph': '#009e73',
    'pod': '#8a8a8a',
    'ours': '#d55e00',
    'projection': '#cc79a7',
    'paper': '#222222',
}
