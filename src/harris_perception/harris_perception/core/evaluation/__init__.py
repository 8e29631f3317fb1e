"""Comparison with other libraries on images with known truth.

``repeatability`` of corners (C. Schmid et al., IJCV 2000), ``boundary_evaluation`` of edges (P. Arbelaez et al., PAMI
2011), ``stereo_evaluation`` of disparities (Middlebury).
"""
