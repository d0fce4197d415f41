"""Figures of reports."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .channels import (
        ChannelMark as ChannelMark,
        channel_map_figure as channel_map_figure,
        pair_bar_figure as pair_bar_figure,
        ring_figure as ring_figure,
    )
    from .characterisation import (
        lines_figure as lines_figure,
        relaxations_figure as relaxations_figure,
        settling_by_strain_figure as settling_by_strain_figure,
    )
    from .data_sheet import (
        PlaceMap as PlaceMap,
        PlaceValue as PlaceValue,
        characteristic_figure as characteristic_figure,
        loop_figure as loop_figure,
        place_maps_figure as place_maps_figure,
    )
    from .estimates import PlacedLoad as PlacedLoad, error_scale as error_scale, estimates_figure as estimates_figure
    from .force import (
        ForcePanel as ForcePanel,
        RatioPoints as RatioPoints,
        force_figure as force_figure,
        ratio_figure as ratio_figure,
    )
    from .images import (
        ImagePanel as ImagePanel,
        Marker as Marker,
        draw_image as draw_image,
        image_figure as image_figure,
        sheet_radius as sheet_radius,
        verdict_figure as verdict_figure,
    )
    from .loads import (
        SeenLoad as SeenLoad,
        arrow_scale as arrow_scale,
        load_images_figure as load_images_figure,
        location_map_figure as location_map_figure,
        random_loads_figure as random_loads_figure,
    )
    from .maps import (
        SheetField as SheetField,
        baseline_figure as baseline_figure,
        force_map_figure as force_map_figure,
    )
    from .metrics import (
        Held as Held,
        SizeSeries as SizeSeries,
        mask_timeline_figure as mask_timeline_figure,
        size_figure as size_figure,
        waiting_figure as waiting_figure,
    )
    from .parameter import (
        ParameterMark as ParameterMark,
        parameter_figure as parameter_figure,
        value_text as value_text,
    )
    from .presses import left_out_figure as left_out_figure
    from .relaxation import (
        SettledLoad as SettledLoad,
        agreement_figure as agreement_figure,
        relaxation_figure as relaxation_figure,
        settling_figure as settling_figure,
    )
    from .sheet import (
        Raster as Raster,
        draw_electrodes as draw_electrodes,
        draw_sheet as draw_sheet,
        fit_sheet as fit_sheet,
        sheet_path as sheet_path,
    )
    from .style import (
        AMOUNT_MAP as AMOUNT_MAP,
        BLUE as BLUE,
        CHANGE_MAP as CHANGE_MAP,
        CYCLE as CYCLE,
        FAINT as FAINT,
        GREEN as GREEN,
        INK as INK,
        ORANGE as ORANGE,
        QUIET as QUIET,
        VERMILION as VERMILION,
        bare as bare,
        canvas as canvas,
        change_norm as change_norm,
        checked_svg as checked_svg,
        dots as dots,
        drawing as drawing,
        drawn as drawn,
        fit_left as fit_left,
        light_grid as light_grid,
        name_rows as name_rows,
        plain_ticks as plain_ticks,
        plot as plot,
        svg_of as svg_of,
    )
    from .time import (
        Budget as Budget,
        Span as Span,
        budget_figure as budget_figure,
        draw_timeline as draw_timeline,
        timeline_figure as timeline_figure,
    )

door(__name__, __file__)
