/* What limits MDE's generations on this processor: the kernel's own work, written by hand in AVX-512 for one size.
 *
 * 30 vectors of dimension 7, a quadratic criterion, partners drawn per component, eight runs. `whole` = 1 does all that
 * a generation needs, to the same bits as the kernel (but for the price of an indefinite mass matrix, which is tested
 * for and not paid); 0 draws the random words and does the sums and products alone: it takes no partners from where
 * chance puts them, decides nothing and keeps nothing. Not part of the package; compiled by optimisers.py.
 */
#include <immintrin.h>
#include <stdint.h>
#include <string.h>

#define N 30
#define ROWS 32
#define D 7
#define RUNS 8
#define WORDS 188 /* of one run's generation */
#define WIDTH 96
#define INLINE static inline __attribute__((always_inline))

typedef struct {
    int64_t threshold, crossover_low, crossover_count;
    double weight_low, weight_step;
} Settings;

typedef struct {
    __m512i a, b, c, counter;
} Streams;

INLINE __m512i next(Streams *s)
{
    __m512i x = _mm512_add_epi64(_mm512_add_epi64(s->a, s->b), s->counter);
    s->counter = _mm512_add_epi64(s->counter, _mm512_set1_epi64(1));
    s->a = _mm512_xor_si512(s->b, _mm512_srli_epi64(s->b, 11));
    s->b = _mm512_add_epi64(s->c, _mm512_slli_epi64(s->c, 3));
    s->c = _mm512_add_epi64(_mm512_rol_epi64(s->c, 24), x);
    return x;
}

/* Words (RUNS, WORDS + 20), eight of every run at a time, turned in registers. */
INLINE void draw(Streams *streams, uint64_t to[RUNS][WORDS + 20])
{
    Streams s = *streams;
    for (int at = 0; at < WORDS; at += 8) {
        __m512i x[8], y[8];
        for (int w = 0; w < 8; w++)
            x[w] = at + w < WORDS ? next(&s) : _mm512_setzero_si512();
        for (int w = 0; w < 8; w += 2) {
            y[w] = _mm512_unpacklo_epi64(x[w], x[w + 1]);
            y[w + 1] = _mm512_unpackhi_epi64(x[w], x[w + 1]);
        }
        for (int w = 0; w < 2; w++) {
            __m512i a = _mm512_shuffle_i64x2(y[w], y[w + 2], 0x88), b = _mm512_shuffle_i64x2(y[w], y[w + 2], 0xdd);
            __m512i c = _mm512_shuffle_i64x2(y[w + 4], y[w + 6], 0x88);
            __m512i d = _mm512_shuffle_i64x2(y[w + 4], y[w + 6], 0xdd);
            _mm512_storeu_si512(&to[w][at], _mm512_shuffle_i64x2(a, c, 0x88));
            _mm512_storeu_si512(&to[4 + w][at], _mm512_shuffle_i64x2(a, c, 0xdd));
            _mm512_storeu_si512(&to[2 + w][at], _mm512_shuffle_i64x2(b, d, 0x88));
            _mm512_storeu_si512(&to[6 + w][at], _mm512_shuffle_i64x2(b, d, 0xdd));
        }
    }
    *streams = s;
}

/* 32-bit digits of sixteen numbers, whose even and odd ones are multiplied apart; what is left replaces them. */
INLINE __m512i digit(__m512i *even, __m512i *odd, int base)
{
    *even = _mm512_mul_epu32(*even, _mm512_set1_epi64(base)), *odd = _mm512_mul_epu32(*odd, _mm512_set1_epi64(base));
    return _mm512_mask_mov_epi32(_mm512_srli_epi64(*even, 32), 0xaaaa, *odd);
}

INLINE __m512d inside(__m512d y, __m512d x, __m512d low, __m512d high)
{
    __mmask8 below = _mm512_cmp_pd_mask(y, low, _CMP_LT_OQ), above = _mm512_cmp_pd_mask(y, high, _CMP_GT_OQ);
    __m512d half = _mm512_mul_pd(_mm512_add_pd(x, _mm512_mask_mov_pd(high, below, low)), _mm512_set1_pd(0.5));
    return _mm512_mask_mov_pd(y, below | above, half);
}

INLINE void mutate(const Settings *how, const uint64_t *drawn, const double *population, const double *lower,
    const double *upper, double trials[D][ROWS], int whole)
{
    const uint32_t *F = (const uint32_t *)drawn;
    const uint16_t *CR = (const uint16_t *)(F + N), *jrand = CR + N;
    const uint32_t *partners = (const uint32_t *)(jrand + N);
    const uint16_t *chances = (const uint16_t *)(partners + N * D);
    const __m512i one = _mm512_set1_epi32(1), threshold = _mm512_set1_epi32(how->threshold);
    __m512i crossing[2], best[2], forced[2];
    __m512d weight[4];
    for (int h = 0; h < 4; h++) {
        __m512d f = _mm512_cvtepi32_pd(_mm256_srli_epi32(_mm256_loadu_si256((const void *)(F + 8 * h)), 1));
        weight[h] = _mm512_add_pd(_mm512_set1_pd(how->weight_low), _mm512_mul_pd(f, _mm512_set1_pd(how->weight_step)));
    }
    for (int h = 0; h < 2; h++) {
        __m512i c = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)(CR + 16 * h)));
        __m512i j = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)(jrand + 16 * h)));
        c = _mm512_srli_epi32(_mm512_mullo_epi32(c, _mm512_set1_epi32(how->crossover_count)), 16);
        crossing[h] = _mm512_add_epi32(c, _mm512_set1_epi32(how->crossover_low));
        best[h] = _mm512_srli_epi32(_mm512_mullo_epi32(crossing[h], threshold), 15);
        forced[h] = _mm512_srli_epi32(_mm512_mullo_epi32(j, _mm512_set1_epi32(D)), 16);
    }
    for (int j = 0; j < D; j++) {
        const double *x = population + j * WIDTH;
        __m512d low = _mm512_set1_pd(lower[j]), high = _mm512_set1_pd(upper[j]);
        for (int h = 0; h < 4 && !whole; h++) {
            __m512d own = _mm512_loadu_pd(x + 8 * h);
            __m512d a = _mm512_loadu_pd(x + 8 * h + 1), b = _mm512_loadu_pd(x + 8 * h + 2);
            __m512d y = _mm512_add_pd(_mm512_mul_pd(_mm512_sub_pd(a, b), weight[h]), own);
            _mm512_storeu_pd(&trials[j][8 * h], inside(y, own, low, high));
        }
        for (int h = 0; h < 2 && whole; h++) {
            __m512i even = _mm512_loadu_si512(partners + j * N + 16 * h), odd = _mm512_srli_epi64(even, 32);
            __m512i p = digit(&even, &odd, N - 1), m = digit(&even, &odd, N - 2), b = digit(&even, &odd, N - 3);
            m = _mm512_mask_add_epi32(m, _mm512_cmpge_epi32_mask(m, p), m, one);
            __m512i least = _mm512_min_epi32(p, m), most = _mm512_max_epi32(p, m);
            b = _mm512_mask_add_epi32(b, _mm512_cmpge_epi32_mask(b, least), b, one);
            b = _mm512_mask_add_epi32(b, _mm512_cmpge_epi32_mask(b, most), b, one);
            __m512i chance = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const void *)(chances + j * N + 16 * h)));
            chance = _mm512_srli_epi32(chance, 1);
            __mmask16 is_forced = _mm512_cmpeq_epi32_mask(forced[h], _mm512_set1_epi32(j));
            __mmask16 crosses = is_forced | _mm512_cmplt_epi32_mask(chance, crossing[h]);
            __mmask16 is_best = _mm512_cmplt_epi32_mask(chance, _mm512_mask_mov_epi32(best[h], is_forced, threshold));
            __m512i own = _mm512_add_epi32(
                _mm512_set_epi32(16, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1), _mm512_set1_epi32(16 * h));
            p = _mm512_add_epi32(p, own), m = _mm512_add_epi32(m, own);
            b = _mm512_mask_mov_epi32(_mm512_add_epi32(b, own), is_best, _mm512_set1_epi32(2 * N));
            for (int k = 0; k < 2; k++) {
                __m256i pk = k ? _mm512_extracti64x4_epi64(p, 1) : _mm512_castsi512_si256(p);
                __m256i mk = k ? _mm512_extracti64x4_epi64(m, 1) : _mm512_castsi512_si256(m);
                __m256i bk = k ? _mm512_extracti64x4_epi64(b, 1) : _mm512_castsi512_si256(b);
                __m512d y = _mm512_sub_pd(_mm512_i32gather_pd(pk, x, 8), _mm512_i32gather_pd(mk, x, 8));
                y = _mm512_add_pd(_mm512_mul_pd(y, weight[2 * h + k]), _mm512_i32gather_pd(bk, x, 8));
                __m512d target = _mm512_loadu_pd(x + 16 * h + 8 * k);
                y = _mm512_mask_mov_pd(target, crosses >> (8 * k), y);
                _mm512_storeu_pd(&trials[j][16 * h + 8 * k], inside(y, target, low, high));
            }
        }
    }
}

INLINE int64_t evaluate(const double *data, const double trials[D][ROWS], double *values)
{
    const double *y = data + D * D, floor = y[D], limit = y[D + 2];
    const __m512d factor = _mm512_set1_pd((1.0 + 1e-12) / (limit * limit));
    int64_t dear = 0;
    for (int h = 0; h < 4; h++) {
        __m512d x[D], sum = _mm512_setzero_pd();
        for (int j = 0; j < D; j++)
            x[j] = _mm512_loadu_pd(&trials[j][8 * h]);
        for (int k = 0; k < D; k++) {
            __m512d r = _mm512_sub_pd(_mm512_mul_pd(_mm512_set1_pd(data[k * D + k]), x[k]), _mm512_set1_pd(y[k]));
            for (int j = k + 1; j < D; j++)
                r = _mm512_add_pd(r, _mm512_mul_pd(_mm512_set1_pd(data[k * D + j]), x[j]));
            sum = _mm512_add_pd(sum, _mm512_mul_pd(r, r));
        }
        __m512d square = _mm512_mul_pd(_mm512_mul_pd(x[2], x[2]), factor);
        dear |= (uint8_t)~_mm512_cmp_pd_mask(square, _mm512_mul_pd(x[0], x[1]), _CMP_LT_OQ);
        _mm512_storeu_pd(values + 8 * h, _mm512_add_pd(sum, _mm512_set1_pd(floor)));
    }
    return dear;
}

INLINE double select_better(double *population, const double trials[D][ROWS], const double *offered, double *values)
{
    __mmask8 better[4];
    __m512d least = _mm512_set1_pd(__builtin_inf()), value[4];
    for (int h = 0; h < 4; h++) {
        __m512d old = _mm512_loadu_pd(values + 8 * h), new = _mm512_loadu_pd(offered + 8 * h);
        better[h] = _mm512_cmp_pd_mask(new, old, _CMP_LE_OQ) & (h < 3 ? 0xff : 0x3f);
        value[h] = _mm512_mask_mov_pd(old, better[h], new);
        _mm512_storeu_pd(values + 8 * h, value[h]);
        least = _mm512_min_pd(least, value[h]);
    }
    double lowest = _mm512_reduce_min_pd(least);
    uint32_t where = 0;
    for (int h = 0; h < 4; h++)
        where |= (uint32_t)_mm512_cmp_pd_mask(value[h], _mm512_set1_pd(lowest), _CMP_EQ_OQ) << (8 * h);
    int best = __builtin_ctz(where);
    for (int j = 0; j < D; j++) {
        double *x = population + j * WIDTH;
        __m512d row[4];
        for (int h = 0; h < 4; h++) {
            row[h] = _mm512_mask_mov_pd(_mm512_loadu_pd(x + 8 * h), better[h], _mm512_loadu_pd(&trials[j][8 * h]));
            _mm512_storeu_pd(x + 8 * h, row[h]);
        }
        for (int h = 0; h < 4; h++)
            _mm512_storeu_pd(x + N + 8 * h, row[h]);
        x[2 * N] = x[best];
    }
    return lowest;
}

INLINE int64_t generations(int64_t count, const Settings *how, const double *data, const double *lower,
    const double *upper, uint64_t *streams, double *vectors, double *values, double *history, int whole)
{
    static _Alignas(64) double population[RUNS][D * WIDTH], costs[RUNS][ROWS], trials[D][ROWS], offered[ROWS];
    static _Alignas(64) uint64_t drawn[RUNS][WORDS + 20], state[4][RUNS];
    int64_t dear = 0;
    for (int r = 0; r < RUNS; r++) {
        for (int k = 0; k < 4; k++)
            state[k][r] = streams[4 * r + k];
        for (int j = 0; j < D; j++) {
            const double *from = vectors + (r * D + j) * (N + 1);
            memcpy(population[r] + j * WIDTH, from, N * 8), memcpy(population[r] + j * WIDTH + N, from, (N + 1) * 8);
        }
        for (int t = 0; t < ROWS; t++)
            costs[r][t] = t < N ? values[r * N + t] : __builtin_inf();
    }
    Streams s = {_mm512_load_si512(state[0]), _mm512_load_si512(state[1]), _mm512_load_si512(state[2]),
        _mm512_load_si512(state[3])};
    for (int64_t k = 0; k < count; k++) {
        draw(&s, drawn);
        for (int r = 0; r < RUNS; r++) {
            mutate(how, drawn[r], population[r], lower, upper, trials, whole);
            dear += evaluate(data, trials, offered) != 0;
            history[r * count + k] = whole ? select_better(population[r], trials, offered, costs[r]) : offered[0];
        }
    }
    return dear;
}

/* Arguments as of the kernel's pendubot_mde, for eight runs from after their first generation on; returns how often the
 * mass matrix of some vector was indefinite. */
int64_t limit(int64_t whole, int64_t count, const Settings *how, const double *data, const double *lower,
    const double *upper, uint64_t *streams, double *vectors, double *values, double *history)
{
    return whole ? generations(count, how, data, lower, upper, streams, vectors, values, history, 1)
                 : generations(count, how, data, lower, upper, streams, vectors, values, history, 0);
}
