{% if d.suspects %}
{% include b.type ~ "/fragments/size_of.c" %}
{% if d.mends %}
{% include "common/fragments/without.c" %}
{% endif %}
{% include "common/fragments/name_suspect.c" %}
{% include "common/fragments/step_checked.c" %}
{% endif %}
