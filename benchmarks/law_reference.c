/* Eq. (1) with Eq. (2) on one half-cycle, for the C compiler's own vector mathematics (glibc's libmvec). */
#include <math.h>
#include <stddef.h>

void branch(double *out, const double *x, const double *speed, ptrdiff_t n, double origin, double reset,
            double stiffness, double capacity, double beta, double gamma)
{
    const double per_capacity = 1.0 / capacity, per_beta = 1.0 / beta;
#pragma omp simd
    for (ptrdiff_t i = 0; i < n; ++i) {
        const double e = stiffness * (x[i] - origin) + reset;
        const double power = beta * log(fmax(fabs(e) * per_capacity, 1e-290));
        const double soft = fmax(power, 0.0) + log(1.0 + exp(-fabs(power)));
        out[i] = e * exp(-soft * per_beta) * (1.0 + gamma * speed[i]);
    }
}

void force(double *out, const double *x, const double *speed, const ptrdiff_t *start, const double *turning,
           ptrdiff_t n_half, const double *law)
{
    double reset = 0.0;
    for (ptrdiff_t k = 0; k < n_half; ++k) {
        const ptrdiff_t a = start[k];
        branch(out + a, x + a, speed + a, start[k + 1] - a, turning[k], reset, law[0], law[1], law[2], law[3]);
        if (k + 1 < n_half) {
            const double zero = 0.0;
            double next;
            branch(&next, &turning[k + 1], &zero, 1, turning[k], reset, law[0], law[1], law[2], 0.0);
            reset = next;
        }
    }
}
