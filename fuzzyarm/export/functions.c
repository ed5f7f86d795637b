/* The functions that exported laws use in place of the math library, and what surrounds a law. @marks@ depend on the
type of the numbers and on the law. */

/* @@ rint */
/* The nearest whole number, the even one of two; exact. */
static @real@ rint_(@real@ x)
{
    const @real@ large = @large@;
    @real@ result = x;
    if ((x > -large) && (x < large)) {
        result = (x > @zero@) ? ((x + large) - large) : ((x - large) + large);
        if (result == @zero@) {
            result = x * @zero@;
        }
    }
    return result;
}

/* @@ floor */
/* The largest whole number that is not above x; exact. */
static @real@ floor_(@real@ x)
{
    const @real@ nearest = rint_(x);
    return (nearest > x) ? (nearest - @one@) : nearest;
}

/* @@ abs */
static @real@ abs_(@real@ x)
{
    return (x <= @zero@) ? (@zero@ - x) : x;
}

/* @@ sqrt */
/* The square root, rounded correctly: y = x/scale^2 in [1, 4), Newton, exact residual y - r^2. */
static @real@ sqrt_(@real@ x)
{
    static const @real@ power[@steps@] = {
@powers@
    };
    static const @real@ root[@steps@] = {
@roots@
    };
    const @real@ unit = @epsilon@_EPSILON;
    @real@ result = x;
    if ((x > @zero@) && (x <= @epsilon@_MAX)) {
        const _Bool tiny = x < @epsilon@_MIN;
        @real@ scale = tiny ? @drop@ : @one@;
        @real@ y = tiny ? (x * @lift@) : x;
        @real@ r;
        @real@ high;
        @real@ low;
        @real@ residual;
        int k;
        for (k = 0; k < @steps@; k++) {
            if (y >= power[k]) {
                y = y * (@one@ / power[k]);
                scale = scale * root[k];
            }
            if ((y * power[k]) < @four@) {
                y = y * power[k];
                scale = scale * (@one@ / root[k]);
            }
        }
        r = @half@ + (@half@ * y);
        for (k = 0; k < 5; k++) {
            r = @half@ * (r + (y / r));
        }
        high = @split@ * r;
        high = high - (high - r);
        low = r - high;
        residual = ((y - (high * high)) - (@two@ * (high * low))) - (low * low);
        if (residual > (r * unit)) {
            r = r + unit;
        } else if (residual <= -(r * unit)) {
            r = r - unit;
        } else {
            /* r is the nearest number. */
        }
        result = r * scale;
    } else if (x < @zero@) {
        result = (x - x) / (x - x);
    } else {
        /* 0, infinity and what is no number stay so. */
    }
    return result;
}

/* @@ place */
/* The row of a place in a table: the nearest one inside, and the first of what is no number. */
static int place_(@real@ x, int last)
{
    return (x > @zero@) ? ((x < (@real@)last) ? (int)x : last) : 0;
}

/* @@ guard */
    /* A sensor drops out: the last torques hold. */
    for (int k = 0; k < @inputs@; k++) {
        if (!((observation[k] >= -@most@) && (observation[k] <= @most@))) {
            for (int j = 0; j < @results@; j++) {
                torque[j] = state->torque[j];
            }
            return 1;
        }
    }

/* @@ hold */
    /* A result that is not finite is not applied, and the memory begins again. */
    for (int k = 0; k < @results@; k++) {
        if ((torque[k] - torque[k]) != @zero@) {
            for (int j = 0; j < @results@; j++) {
                torque[j] = state->torque[j];
            }
            for (int j = 0; j < @memory@; j++) {
                state->memory[j] = @zero@;
            }
            return 2;
        }
    }
    for (int k = 0; k < @results@; k++) {
        state->torque[k] = torque[k];
    }

/* @@ check */
    for (int k = 0; k < @results@; k++) {
        if ((@result@[k] - @result@[k]) != @zero@) {
            return 2;
        }
    }

/* @@ end */
    return 0;
