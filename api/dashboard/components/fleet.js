// The fleet table: one row a UAV, drawn from the same frames as the map. A row is a button: it selects the UAV.
export default {
  template: `
    <table class="sf-fleet" aria-label="fleet">
      <thead><tr>
        <th scope="col">UAV</th><th scope="col">State</th><th scope="col" title="mission item being flown">Item</th>
        <th scope="col" title="metres from where the plan has it now; while it moves also seconds behind (+) or ahead of (−) its schedule">Slip</th>
        <th scope="col" title="seconds since the last heartbeat">Heartbeat</th><th scope="col">Batt</th>
        <th v-if="has_energy" scope="col" title="Wh used since the battery was full; what is proven to be spare above the reserve when it comes home">Energy</th>
        <th scope="col" title="metres above home">Alt</th>
      </tr></thead>
      <tbody>
        <tr v-for="row in rows" :key="row.id" :data-uav="row.id" :data-link="row.link" :data-lost="row.lost"
            :class="{ lost: row.lost, stale: !row.lost && row.link === 'stale', selected: row.id === selected }"
            tabindex="0" :aria-selected="row.id === selected" @click="choose(row.id)"
            @keydown.enter.prevent="choose(row.id)" @keydown.space.prevent="choose(row.id)"
            @keydown.down.prevent="go($event, 'nextElementSibling')" @keydown.up.prevent="go($event, 'previousElementSibling')">
          <th scope="row"><span class="sf-dot" :style="{ background: row.lost ? 'transparent' : row.colour }"></span>{{ row.id }}</th>
          <td class="sf-state"><span class="sf-badge" :class="row.level">{{ row.state }}</span><span v-if="row.cause" class="sf-cause">{{ row.cause }}</span></td>
          <td>{{ row.item ?? "–" }}<template v-if="row.items">/{{ row.items }}</template></td>
          <td :class="{ late: is_off(row.slip) }">{{ off(row.slip) }}</td>
          <td><span class="sf-bars" :data-bars="bars(row)" aria-hidden="true"><i></i><i></i><i></i><i></i></span> {{ row.age === null ? "–" : row.age.toFixed(1) + " s" }}</td>
          <td :class="{ late: row.battery !== null && row.battery < 25 }">{{ row.battery === null ? "–" : Math.round(row.battery) + " %" }}</td>
          <td v-if="has_energy" class="sf-energy" :class="{ late: row.energy && row.energy[1] < 0 }">{{ energy(row.energy) }}</td>
          <td>{{ row.alt === null ? "–" : row.alt.toFixed(0) + " m" }}</td>
        </tr>
        <tr v-if="!rows.length"><td :colspan="has_energy ? 8 : 7" class="sf-empty">No vehicle is registered. Start an operation from the Plan page.</td></tr>
      </tbody>
    </table>`,
  data: () => ({ rows: [], selected: null }),
  computed: {
    has_energy() {
      return this.rows.some((row) => row.energy);
    },
  },
  methods: {
    set_rows(rows) {
      this.rows = rows;
    },
    select(id) {
      this.selected = id;
    },
    choose(id) {
      this.selected = this.selected === id ? null : id;
      this.$emit("pick", { kind: "uav", id: this.selected });
    },
    go(event, way) {
      event.currentTarget[way]?.focus();
    },
    off(slip) {
      if (!slip) return "–";
      const [off_m, late_s] = slip;
      const late = late_s === null ? "" : ", " + (late_s >= 0 ? "+" : "−") + Math.abs(late_s).toFixed(1) + " s";
      return off_m.toFixed(1) + " m" + late;
    },
    is_off(slip) {
      return !!slip && (slip[1] === null ? slip[0] >= 5 : Math.abs(slip[1]) > 3);
    },
    energy(wh) {
      if (!wh) return "–";
      const sign = wh[1] < 0 ? "−" : "";
      return wh[0].toFixed(1) + " Wh, " + sign + Math.abs(wh[1]).toFixed(1) + " spare";
    },
    bars(row) {
      if (row.lost || row.link === "lost") return 0;
      if (row.link === "stale") return 1;
      if (row.quality !== null && row.quality !== undefined) return Math.max(1, Math.round(row.quality * 4));
      return row.age === null ? 0 : row.age < 1.5 ? 4 : row.age < 2.2 ? 3 : 2;
    },
  },
};
