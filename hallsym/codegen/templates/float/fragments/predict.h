
/** @name Result of decoupler_predict(): 0, or why the pose is no good prediction */
/** @{ */
#define DECOUPLER_PREDICT_STARTING 0x01UL /**< too few samples since the start or a gap */
#define DECOUPLER_PREDICT_AHEAD 0x02UL /**< time that is not finite or longer than a gap may be: none is added */
/** @} */

/** Position and speed as a second-order observer has them; begins with {0}. */
typedef struct
{
{% for o in outputs %}
    {{ o.type }} {{ o.member }}; /**< [{{ o.unit }}] at the last sample */
{% endfor %}
{% for o in outputs %}
    {{ o.type }} speed_{{ o.name }}; /**< [{{ o.unit }}/s] */
{% endfor %}
    float gap; /**< [s] since the last usable sample */
    uint32_t samples; /**< used since the start */
} decoupler_track_t;

/**
 * Give the observer a sample, usable or not: over one that is not it goes on at its speed.
 * @param[in] p table, as of decoupler_step()
 * @param[in,out] track of one machine
 * @param[in] pose of decoupler_step()
 * @param[in] status of decoupler_step()
 * @param[in] dt [s] from the timestamp of the sample before to that of this one; a longer gap starts anew
 */
void decoupler_track(const decoupler_params_t *p, decoupler_track_t *track, const decoupler_out_t *pose,
                     uint32_t status, float dt);

/**
 * Where the machine is some time after the timestamp of the last sample; the latency of the table is added.
 * @param[in] p table, as of decoupler_step()
 * @param[in] track of the machine
 * @param[in] ahead [s] from that timestamp on
 * @param[out] pose always finite
 * @return 0, or DECOUPLER_PREDICT_* bits
 */
uint32_t decoupler_predict(const decoupler_params_t *p, const decoupler_track_t *track, float ahead,
                           decoupler_out_t *pose);
