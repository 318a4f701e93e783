/* Counts the directions of a white Lambertian surface in patches of equal projected
 * solid angle: what the instrument's kernel does, written by hand for the benchmark.
 *
 * Two random numbers give a direction by the concentric map of the disk. Its ring and
 * sector are found from the direction alone, by the rule of gonio_mi/collector, and
 * one of 32-bit counters is raised. All but the last step goes through the vector
 * registers of this machine: 4, 8 or 16 rays at a time, by the vector types of GCC and
 * Clang. The coefficients are Chebyshev fits, good to single precision.
 *
 * Rays are sent in chunks, each with random numbers of its own, which threads take as
 * they get free; so the counts do not depend on the number of threads.
 */

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__AVX512F__)
#define LANES 16
#elif defined(__AVX2__)
#define LANES 8
#include <immintrin.h>
#else
#define LANES 4
#endif

#define CHUNK (1u << 20)
#define TABLES 4 /* neighbouring rays count in different tables: no waiting for memory */

#define EDGE 0x1p-20f
#define TWO_PI 6.283185307179586f

typedef float floats __attribute__((vector_size(4 * LANES)));
typedef int32_t ints __attribute__((vector_size(4 * LANES)));
typedef uint32_t words __attribute__((vector_size(4 * LANES)));

static inline floats blend(ints mask, floats yes, floats no)
{
#if LANES == 8
    return _mm256_blendv_ps(no, yes, (floats)mask); /* which the compilers do not find */
#else
    return (floats)((mask & (ints)yes) | (~mask & (ints)no));
#endif
}

static inline floats to_floats(ints x) { return __builtin_convertvector(x, floats); }
static inline ints truncated(floats x) { return __builtin_convertvector(x, ints); }
static inline floats absolute(floats x) { return (floats)((ints)x & 0x7fffffff); }

static inline floats root(floats x)
{
    for (int i = 0; i < LANES; ++i)
        x[i] = __builtin_sqrtf(x[i]);
    return x;
}

/* ------------------------------------------------------------------ random numbers */

/* xoshiro128++ of Blackman and Vigna 2019, one generator in each lane. */
typedef struct { words a, b, c, d; } Generator;

static uint64_t splitmix(uint64_t *state)
{
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static Generator seeded(uint64_t seed, uint64_t chunk)
{
    uint64_t state = chunk;
    state = seed ^ splitmix(&state);
    Generator g;
    for (int i = 0; i < LANES; ++i) {
        uint64_t low = splitmix(&state), high = splitmix(&state);
        g.a[i] = (uint32_t)low;
        g.b[i] = (uint32_t)(low >> 32);
        g.c[i] = (uint32_t)high;
        g.d[i] = (uint32_t)(high >> 32);
    }
    return g;
}

static inline words rotated(words x, int k) { return (x << k) | (x >> (32 - k)); }

/* Multiples of 2**-24 in [0, 1). */
static inline floats uniform(Generator *g)
{
    words result = rotated(g->a + g->d, 7) + g->a;
    words shifted = g->b << 9;
    g->c ^= g->a;
    g->d ^= g->b;
    g->b ^= g->c;
    g->a ^= g->d;
    g->c ^= shifted;
    g->d = rotated(g->d, 11);
    return to_floats((ints)(result >> 8)) * 0x1p-24f;
}

/* --------------------------------------------------------------- direction and patch */

/* Point of the unit disk: concentric map of Shirley and Chiu 1997. */
static inline void disk(floats u, floats v, floats *x, floats *y)
{
    floats a = 2 * u - 1, b = 2 * v - 1;
    ints wide = absolute(a) > absolute(b);
    floats r = blend(wide, a, b), other = blend(wide, b, a);
    floats t = other / blend(r == 0, r + 1, r), w = t * t;
    floats s = t * (7.853981610e-01f + w * (-8.074543477e-02f
             + w * (2.490006964e-03f + w * -3.595439926e-05f)));
    floats c = 1.0f + w * (-3.084251352e-01f + w * (1.585432524e-02f
             + w * (-3.259386002e-04f + w * 3.529804255e-06f)));
    *x = r * blend(wide, c, s);
    *y = r * blend(wide, s, c);
}

static inline floats angle(floats y, floats x)
{
    floats ax = absolute(x), ay = absolute(y);
    ints steep = ay > ax;
    floats low = blend(steep, ax, ay), high = blend(steep, ay, ax);
    floats q = low / blend(high == 0, high + 1, high), w = q * q;
    floats phi = q * (9.999998978e-01f + w * (-3.333195972e-01f
               + w * (1.996923539e-01f + w * (-1.401658504e-01f
               + w * (9.906096896e-02f + w * (-5.936710079e-02f
               + w * (2.416618952e-02f + w * -4.668773308e-03f)))))));
    phi = blend(steep, TWO_PI / 4 - phi, phi);
    phi = blend(x < 0, TWO_PI / 2 - phi, phi);
    return blend(y < 0, -phi, phi);
}

static inline ints smaller(ints a, int b) { return (a & (a < b)) | (b & ~(a < b)); }

static inline ints patch(floats x, floats y, floats z, int n_theta, int n_phi)
{
    floats sin2 = x * x + y * y, cos2 = z * z;
    floats up = cos2 * (n_theta * (1 - EDGE));
    ints whole = truncated(up);
    ints from_horizon = n_theta - whole + (up > to_floats(whole));
    ints from_pole = truncated(sin2 * (n_theta * (1 + EDGE)));
    ints near_pole = sin2 < cos2;
    ints ring = (near_pole & from_pole) | (~near_pole & from_horizon);

    floats turn = (angle(y, x) + EDGE) * (n_phi / TWO_PI);
    ints sector = truncated(blend(turn < 0, turn + (float)n_phi, turn));
    return smaller(ring, n_theta - 1) * n_phi + (sector & (sector < n_phi));
}

/* -------------------------------------------------------------------------- threads */

typedef struct {
    uint64_t rays, seed, *counts;
    int n_theta, n_phi, failed;
    atomic_ullong next_chunk;
    pthread_mutex_t lock;
} Job;

static void count_chunk(const Job *job, uint64_t chunk, uint32_t *tables)
{
    const int n_theta = job->n_theta, n_phi = job->n_phi;
    const uint32_t n_patches = n_theta * n_phi;
    uint64_t left = job->rays - chunk * CHUNK;
    uint32_t rays = left < CHUNK ? left : CHUNK;
    Generator g = seeded(job->seed, chunk);
    for (uint32_t begin = 0; begin < rays; begin += LANES) {
        floats x, y, u = uniform(&g), v = uniform(&g);
        disk(u, v, &x, &y);
        floats cos2 = 1 - x * x - y * y;
        ints p = patch(x, y, root(blend(cos2 > 0, cos2, 0 * cos2)), n_theta, n_phi);
        int lanes = rays - begin < LANES ? (int)(rays - begin) : LANES;
        if (lanes == LANES) {
            int32_t at[LANES] __attribute__((aligned(4 * LANES)));
            memcpy(at, &p, sizeof p);
            for (int i = 0; i < LANES; ++i)
                ++tables[i % TABLES * n_patches + at[i]];
        } else {
            for (int i = 0; i < lanes; ++i)
                ++tables[p[i]];
        }
    }
}

static void *work(void *argument)
{
    Job *job = argument;
    size_t n_patches = (size_t)job->n_theta * job->n_phi;
    uint32_t *tables = calloc(TABLES * n_patches, sizeof *tables);
    uint64_t *sums = calloc(n_patches, sizeof *sums);
    if (tables && sums) {
        uint64_t chunk, n_chunks = (job->rays + CHUNK - 1) / CHUNK;
        while ((chunk = atomic_fetch_add(&job->next_chunk, 1)) < n_chunks) {
            count_chunk(job, chunk, tables);
            for (size_t i = 0; i < TABLES * n_patches; ++i)
                sums[i % n_patches] += tables[i];
            memset(tables, 0, TABLES * n_patches * sizeof *tables);
        }
    }
    pthread_mutex_lock(&job->lock);
    job->failed |= !(tables && sums);
    for (size_t i = 0; sums && i < n_patches; ++i)
        job->counts[i] += sums[i];
    pthread_mutex_unlock(&job->lock);
    free(tables);
    free(sums);
    return NULL;
}

/* Adds the counts of `rays` rays to `counts`, n_theta * n_phi numbers; 0 if all went
 * well, 1 if memory or a thread could not be had. */
int count_diffuse(uint64_t rays, uint64_t seed, int n_theta, int n_phi, int n_threads,
                  uint64_t *counts)
{
    Job job = {.rays = rays, .seed = seed, .counts = counts,
               .n_theta = n_theta, .n_phi = n_phi};
    pthread_mutex_init(&job.lock, NULL);
    pthread_t threads[256];
    int started = 0;
    while (started < n_threads && started < 256
           && !pthread_create(&threads[started], NULL, work, &job))
        ++started;
    for (int i = 0; i < started; ++i)
        pthread_join(threads[i], NULL);
    pthread_mutex_destroy(&job.lock);
    return job.failed || !started;
}
