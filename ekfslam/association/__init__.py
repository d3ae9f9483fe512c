"""Who saw whom: decisions from innovations and their covariances, knowing no filter.

======================  ========================================================================
method                  decision, its source, and what its threshold is on
======================  ========================================================================
``known``               the identities of the data (Principles of Robot Autonomy, Alg. 1; Ciatto,
                        3.4; Solà, C.3); no threshold
``nearest``             nearest in innovation distance inside one gate, new beyond another,
                        ambiguous in between (Solà, C.3, with 3 sigma, ``z' Z^-1 z < 9``; two
                        gates: Bailey et al. 2006); squared Mahalanobis distance
``euclidean``           nearest to the back-projected point within epsilon, else new (notes on
                        Brenner's lectures); metres
``euclidean-first``     first in the map within D_min of the back-projected point, else new
                        (Ciatto, 3.6, first example); metres
``mahalanobis-first``   the same in the landmark's own covariance (Ciatto, 3.6, second example,
                        and A.4); Mahalanobis distance, not squared
``smallest-distance``   smallest innovation distance, alpha being that of a new landmark
                        (Principles of Robot Autonomy, Alg. 2); squared Mahalanobis distance
``maximum-likelihood``  smallest ``d^2 + ln det S`` inside the gate (Principles of Robot Autonomy,
                        17.2, by its text; Blanco et al. 2012); gates as for ``nearest``
``global``              the assignment of all observations of a look at the smallest total
                        distance, none costing its gate; gates as for ``nearest``
``joint``               most pairs that are jointly compatible (Neira and Tardós 2001); gates as
                        for ``nearest``, and one on the joint squared Mahalanobis distance
======================  ========================================================================

Gates on squared distances are stated as probabilities, see `ekfslam.association.gates`. A look is
what one sensor saw at one instant; in it, ``nearest``, ``maximum-likelihood``, ``global`` and
``joint`` let a landmark be seen once.
"""
